"""What may be on board of a UAV: offered, sent, proven; and what a lost one therefore keeps reserved."""

from __future__ import annotations

from typing import Any

import pytest

from skyfolio.api.common.fleet_clock import FleetClock
from skyfolio.api.flights.guidance import FlightGuidance
from skyfolio.api.flights.missions_on_board import MissionsOnBoard
from skyfolio.mavlink_bridge import Autopilot
from skyfolio.mavlink_bridge.px4 import PX4_MODEL as PX4
from skyfolio.mavlink_bridge.verified import OnBoard
from skyfolio.planner import EXAMPLES, Plan, plan
from tests.api.test_assigned_missions import assigned


class NoLink:
    """The fleet as far as compiling needs it: two PX4s."""

    class link:  # noqa: N801
        autopilot = staticmethod(lambda _system_id: Autopilot.PX4)
        model = staticmethod(lambda _system_id: PX4)

    def note(self, _kind: str, **_data: Any) -> None:
        """Nobody listens."""


@pytest.fixture(scope="module")
def minimal() -> Plan:
    return plan(EXAMPLES["minimal"]())


@pytest.fixture
def guidance(minimal: Plan) -> FlightGuidance:
    fleet: Any = NoLink()
    systems = {uav: number for number, uav in enumerate(minimal.scenario.uav_ids, start=1)}
    return FlightGuidance(systems, fleet, FleetClock(1.0), elapsed_s=lambda: 20.0, homes_m={})


def elsewhere(minimal: Plan, east_m: float) -> Plan:
    """The same plan, `east_m` further east."""
    paths = {uav: [(e + east_m, n) for e, n in path] for uav, path in minimal.trajectories_m.items()}
    return minimal.model_copy(update={"trajectories_m": paths})


def easts_reserved(guidance: FlightGuidance) -> list[float]:
    """Where the routes that are reserved for uav-1 begin."""
    guidance.reserve("uav-1", (0.0, 0.0))
    (ghost,) = guidance.airspace.ghosts.values()
    return [way.route.path_m[0][0] for way in ghost.ways]


async def on_board(guidance: FlightGuidance, minimal: Plan) -> float:
    """uav-1 verifiably has the plan's mission; where that begins."""
    mission = guidance.compile(minimal, "uav-1")
    await guidance.record_sending(["uav-1"])
    guidance.record_on_board("uav-1", mission, OnBoard.NEW)
    return minimal.trajectories_m["uav-1"][0][0]


async def test_a_mission_that_was_only_compiled_reserves_no_air(guidance: FlightGuidance, minimal: Plan) -> None:
    flown_m = await on_board(guidance, minimal)
    guidance.compile(elsewhere(minimal, 274.0), "uav-1")
    assert easts_reserved(guidance) == [flown_m]


async def test_while_a_mission_is_sent_both_routes_are_reserved(guidance: FlightGuidance, minimal: Plan) -> None:
    flown_m = await on_board(guidance, minimal)
    guidance.compile(elsewhere(minimal, 274.0), "uav-1")
    await guidance.record_sending(["uav-1"])
    assert easts_reserved(guidance) == [flown_m, flown_m + 274.0]


@pytest.mark.parametrize(
    ("ended", "easts_m"), [(OnBoard.NEW, [274.0]), (OnBoard.OLD, [0.0]), (OnBoard.UNKNOWN, [0.0, 274.0])]
)
async def test_when_it_was_sent_what_is_proven_is_reserved_and_both_where_nothing_is(
    guidance: FlightGuidance, minimal: Plan, ended: OnBoard, easts_m: list[float]
) -> None:
    flown_m = await on_board(guidance, minimal)
    new = guidance.compile(elsewhere(minimal, 274.0), "uav-1")
    await guidance.record_sending(["uav-1"])
    guidance.record_on_board("uav-1", new, ended)
    assert easts_reserved(guidance) == [flown_m + east_m for east_m in easts_m]


async def test_the_ways_of_a_ghost_survive_a_restart(guidance: FlightGuidance, minimal: Plan) -> None:
    await on_board(guidance, minimal)
    guidance.compile(elsewhere(minimal, 274.0), "uav-1")
    await guidance.record_sending(["uav-1"])
    before = easts_reserved(guidance)
    document = guidance.airspace.document()
    guidance.release_air("uav-1")
    guidance.airspace.recall(document)
    (ghost,) = guidance.airspace.ghosts.values()
    assert [way.route.path_m[0][0] for way in ghost.ways] == before


def test_after_a_restart_anything_that_was_sent_may_be_on_board(minimal: Plan) -> None:
    newest, older = (assigned(minimal, "uav-1", Autopilot.PX4, altitude_m) for altitude_m in (65.0, 60.0))
    missions = MissionsOnBoard()
    missions.restore({"uav-1": [newest, older]})
    assert missions.may_fly("uav-1") == (older, newest)
    assert missions.newest() == {"uav-1": newest}
    missions.record_on_board("uav-1", older.mission, OnBoard.NEW)  # read back
    assert missions.may_fly("uav-1") == (older,)
