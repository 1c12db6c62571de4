"""Survivors on their way into a new plan: a second attempt begins elsewhere, so separation is checked again."""

from __future__ import annotations

from typing import Any

import pytest

from skyfolio.api.flights.swap import Swap
from skyfolio.mavlink_bridge import Mission, compile_mission
from skyfolio.mavlink_bridge.ghosts import Airspace
from skyfolio.planner import EXAMPLES, Plan, plan

Point = tuple[float, float]
SLOT_S = 5.0


@pytest.fixture(scope="module")
def minimal() -> Plan:
    return plan(EXAMPLES["minimal"]())


def moved(minimal: Plan, **paths: list[Point]) -> Plan:
    slots = len(next(iter(paths.values())))
    scenario = minimal.scenario.model_copy(update={"slots": slots})
    named = {uav.replace("_", "-"): path for uav, path in paths.items()}
    return minimal.model_copy(update={"trajectories_m": named, "scenario": scenario, "first_slot": 0})


class Guidance:
    airspace = Airspace()

    def compile(self, plan: Plan, uav: str, *, from_m: Point, first_leg_s: float) -> Mission:
        del from_m
        return compile_mission(plan, uav, airborne=True, first_leg_s=first_leg_s)

    async def record_sending(self, _uavs: Any) -> None:
        """Nothing is stored."""


class OneFlight:
    """Two UAVs; `failures` uploads to uav-2 fail, each as late as the others have moved on to `later`."""

    def __init__(self, old: Plan, live: dict[str, Point], later: dict[str, Point], failures: int) -> None:
        self.plan, self.guidance, self.slot_s, self.traffic = old, Guidance(), SLOT_S, None
        self.sent: list[str] = []
        self._live, self._later, self._failures = live, later, failures

    def surviving(self) -> list[str]:
        return ["uav-1", "uav-2"]

    def now_s(self) -> float:
        return 1.0

    def positions_m(self) -> dict[str, Point]:
        return dict(self._live)

    def altitudes_m(self) -> dict[str, float]:
        return {}

    def take_over(self, plan: Plan) -> None:
        self.plan = plan

    def telemetry(self, _uav: str) -> None:
        return None

    async def swap(self, uav: str, _mission: Mission, *, streamed_m: object = None) -> str | None:
        assert streamed_m is None, "a recovery from a loss ends the stream"
        self.sent.append(uav)
        if uav == "uav-2" and self._failures:
            self._failures -= 1
            self._live = self._later
            return "TIMEOUT"
        return None


class Steps:
    async def step_each(self, _step: Any, _data: Any) -> None:
        """No journal."""


class Metrics:
    class upload_retries:  # noqa: N801
        inc = staticmethod(lambda _count: None)


async def swapped(minimal: Plan, later: dict[str, Point]) -> tuple[OneFlight, dict[str, str | None]]:
    east = [(0.0, 0.0), (20.0, 0.0), (40.0, 0.0), (60.0, 0.0)]
    beside = [(0.0, 20.0), (20.0, 20.0), (40.0, 20.0), (60.0, 20.0)]
    new = moved(minimal, uav_1=east, uav_2=beside)
    flight: Any = OneFlight(new, {"uav-1": (0.0, 0.0), "uav-2": (0.0, 20.0)}, later, failures=1)
    steps: Any = Steps()
    metrics: Any = Metrics()
    flight.plan = moved(minimal, uav_1=beside, uav_2=beside)  # no way back either
    return flight, await Swap(flight, steps, metrics, attempts=2).into(new)


async def test_a_second_attempt_from_where_it_still_keeps_apart_is_made(minimal: Plan) -> None:
    flight, results = await swapped(minimal, {"uav-1": (4.0, 0.0), "uav-2": (2.0, 20.0)})
    assert results == {"uav-1": None, "uav-2": None}
    assert flight.sent == ["uav-1", "uav-2", "uav-2"]


async def test_a_second_attempt_that_would_bring_uavs_together_is_not_made(minimal: Plan) -> None:
    flight, results = await swapped(minimal, {"uav-1": (10.0, 10.0), "uav-2": (10.0, 9.0)})
    assert results["uav-1"] is None
    assert str(results["uav-2"]).startswith("transition: 'uav-1' and 'uav-2' would come within")
    assert flight.sent == ["uav-1", "uav-2"]
