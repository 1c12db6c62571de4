"""What tests of operations without a fixed end share: a scenario, and looks at what was flown."""

from __future__ import annotations

from itertools import combinations
from math import hypot, inf
from typing import Any

from skyfolio.api.flights.operation_views import ENDED, OperationView
from skyfolio.mavlink_bridge import geodetic_to_east_north
from skyfolio.planner import EXAMPLES
from tests.api.sky import Sky

HORIZON, EVERY = 20, 5
SCENARIO = EXAMPLES["paper"]().with_changes(slots=HORIZON, altitude_m=10.0)
SLOT_S = SCENARIO.slot_duration_s
IN_THE_AIR_M, ON_THE_GROUND_M = 3.0, 0.1


def take_off(sky: Sky, duration_s: float | None = 600.0, **options: Any) -> str:
    """Start an operation that is extended until then; its id once slot 0 has begun."""
    return sky.take_off(duration_s=duration_s, horizon_slots=HORIZON, replan_every_slots=EVERY, **options)


def ended(sky: Sky, operation_id: str, within_s: float = 1200.0) -> OperationView:
    """The operation when it is over, however it ended."""
    return sky.until(operation_id, lambda view: view.state in ENDED, within_s=within_s, fails=True)


def extensions(view: OperationView) -> list[str]:
    """How the extensions went that the view still has."""
    return [report.outcome for report in view.recoveries if report.cause == "extended"]


class Apart:
    """How close two vehicles in the air have come since it was made, by the simulator's ground truth.

    landings: which vehicles have landed, and with what charge, 0 to 1.
    """

    def __init__(self, sky: Sky) -> None:
        self._sky, self.closest_m, self.at_s = sky, inf, 0.0
        self.landings: list[tuple[int, float]] = []
        self._up: set[int] = set()
        sky.ground.after_step = self._look

    def _look(self) -> None:
        self._look_for_landings()
        origin = self._sky.scenario.origin
        up = [
            geodetic_to_east_north(origin, vehicle.position[0], vehicle.position[1])
            for vehicle in self._sky.fleet.vehicles.values()
            if vehicle.alive and vehicle.autopilot.dynamics.body.up_m > IN_THE_AIR_M
        ]
        for (e0, n0), (e1, n1) in combinations(up, 2):
            if hypot(e1 - e0, n1 - n0) < self.closest_m:
                self.closest_m, self.at_s = hypot(e1 - e0, n1 - n0), self._sky.now_s

    def _look_for_landings(self) -> None:
        for system_id, vehicle in self._sky.fleet.vehicles.items():
            body = vehicle.autopilot.dynamics.body
            if body.up_m > IN_THE_AIR_M:
                self._up.add(system_id)
            elif system_id in self._up and body.up_m <= ON_THE_GROUND_M:
                self._up.discard(system_id)
                self.landings.append((system_id, vehicle.autopilot.battery.share))
