"""A registered vehicle as clients see it."""

from __future__ import annotations

from pydantic import BaseModel

from skyfolio.mavlink_bridge import FleetLink


class VehicleView(BaseModel):
    """A registered vehicle as it last reported. Angles in degrees, altitude in metres above its own home.

    `condition`: what it is in, with `condition_cause`: what was last seen of it, with numbers. `heading_deg`: where the
    nose points, clockwise from north. `power_w`: drawn from its battery; `used_wh`: since it was
    armed. `mission_items`: the number of items of the mission on board.
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
    power_w: float | None = None
    used_wh: float | None = None
    armed: bool | None = None
    mode: str | None = None
    mission_item: int | None = None
    mission_items: int | None = None


def view_of(
    link: FleetLink, uav_id: str, system_id: int, *, now_s: float, simulated: bool, condition_cause: str | None
) -> VehicleView:
    """Return the vehicle as it was last heard on the link.

    now_s: fleet seconds. condition_cause: what was last seen of it, in words.
    """
    monitor, telemetry = link.monitor, link.telemetry(system_id)
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
    if telemetry is None:
        return view
    return view.model_copy(
        update={
            "lat_deg": telemetry.lat_deg,
            "lon_deg": telemetry.lon_deg,
            "relative_alt_m": telemetry.relative_alt_m,
            "heading_deg": telemetry.heading_deg,
            "battery_percent": None if telemetry.battery is None else round(telemetry.battery * 100, 1),
            "power_w": None if telemetry.power_w is None else round(telemetry.power_w, 1),
            "used_wh": None if telemetry.used_wh is None else round(telemetry.used_wh, 3),
            "armed": telemetry.armed,
            "mode": telemetry.mode,
            "mission_item": telemetry.mission_current,
            "mission_items": telemetry.mission_total,
        }
    )
