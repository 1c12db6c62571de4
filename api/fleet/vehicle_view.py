"""A registered vehicle as clients see it."""

from __future__ import annotations

from pydantic import BaseModel

from skyfolio.mavlink_bridge import FleetLink


class VehicleView(BaseModel):
    """A registered vehicle and what it last said. Angles in degrees, altitude in metres above its own home.

    `condition`: what it is in; `condition_cause`: what was last seen of it, with numbers. `heading_deg`: where the nose
    points, clockwise from north. `mission_items`: how many the mission on board has.
    """

    uav_id: str
    system_id: int
    simulated: bool = False
    link: str
    silent_for_s: float | None
    condition: str | None = None
    condition_cause: str | None = None
    lat_deg: float | None = None
    lon_deg: float | None = None
    relative_alt_m: float | None = None
    heading_deg: float | None = None
    battery_percent: float | None = None
    armed: bool | None = None
    mode: str | None = None
    mission_item: int | None = None
    mission_items: int | None = None


def view_of(
    link: FleetLink, uav_id: str, system_id: int, *, now_s: float, simulated: bool, condition_cause: str | None
) -> VehicleView:
    """The vehicle as it was last heard on the link; now_s: the fleet's clock."""
    monitor, said = link.monitor, link.telemetry(system_id)
    watched = system_id in monitor.watched
    view = VehicleView(
        uav_id=uav_id,
        system_id=system_id,
        simulated=simulated,
        link=monitor.state(system_id).value if watched else "unheard",
        silent_for_s=monitor.silent_for_s(system_id, now_s) if watched else None,
        condition=link.classifier.condition(system_id).value if watched else None,
        condition_cause=condition_cause,
    )
    if said is None:
        return view
    return view.model_copy(
        update={
            "lat_deg": said.lat_deg,
            "lon_deg": said.lon_deg,
            "relative_alt_m": said.relative_alt_m,
            "heading_deg": said.heading_deg,
            "battery_percent": None if said.battery is None else round(said.battery * 100, 1),
            "armed": said.armed,
            "mode": said.mode,
            "mission_item": said.mission_current,
            "mission_items": said.mission_total,
        }
    )
