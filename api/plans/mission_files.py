"""The MAVLink missions of a plan, in the file formats that the service and the command line offer."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from skyfolio.api.common.errors import InvalidError
from skyfolio.mavlink_bridge import DEFAULT_AUTOPILOT, Autopilot, Mission, compile_mission, to_qgc_plan, to_waypoints
from skyfolio.mavlink_bridge.altitudes import altitudes_of, ground_m
from skyfolio.mavlink_bridge.fence import fence_items, rally_items
from skyfolio.planner import Plan


class Missions:
    """The missions of one plan, for this autopilot with its default parameters."""

    def __init__(self, plan: Plan, autopilot: Autopilot = DEFAULT_AUTOPILOT) -> None:
        self._plan, self._autopilot = plan, autopilot

    def as_json(self, uav_id: str | None = None) -> dict[str, list[dict[str, Any]]]:
        """Return the MISSION_ITEM_INT rows of each UAV (or of one): degrees times 1e7, metres in `frame`'s datum."""
        ids = self._plan.scenario.uav_ids if uav_id is None else (self._one(uav_id),)
        return {uav: [asdict(item) for item in self._mission(uav).items] for uav in ids}

    def qgc_plan(self, uav_id: str | None) -> dict[str, Any]:
        """Return one UAV's mission as a QGroundControl `.plan`, with the geofence and rally points of its flight."""
        scenario, uav = self._plan.scenario, self._plan.scenario.uav(self._one(uav_id))
        home_alt_m = ground_m(scenario, uav.start_m)
        up_m = altitudes_of(self._plan, uav.id).metres[0] - home_alt_m
        return to_qgc_plan(
            self._mission(uav.id),
            home_alt_m=home_alt_m,
            fence=fence_items(scenario),
            rally=rally_items(scenario, [uav.start_m, *scenario.rally_m], up_m),
        )

    def waypoints(self, uav_id: str | None) -> str:
        """Return one UAV's mission as a `QGC WPL 110` text."""
        return to_waypoints(self._mission(self._one(uav_id)))

    def _mission(self, uav_id: str) -> Mission:
        return compile_mission(self._plan, uav_id, autopilot=self._autopilot)

    def _one(self, uav_id: str | None) -> str:
        """Return the id of the one UAV. Raises InvalidError for an unknown one, or none where there are several."""
        ids = self._plan.scenario.uav_ids
        if uav_id is None and len(ids) == 1:
            return ids[0]
        if uav_id is None:
            raise InvalidError(f"uav_id: this format holds one vehicle; choose one of {', '.join(ids)}")
        if uav_id not in ids:
            raise InvalidError(f"uav_id: {uav_id!r} is not in the plan; it has {', '.join(ids)}")
        return uav_id
