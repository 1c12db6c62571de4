"""Who hovers after the last slot is brought down, and said to be."""

from __future__ import annotations

import pytest

from skyfolio.api.flights.ends import UavEnd
from skyfolio.api.flights.operation_views import State
from skyfolio.api.flights.stragglers import STILL_S, Stillness
from skyfolio.mavlink_bridge import Autopilot
from skyfolio.planner import EXAMPLES
from tests.api.sky import flight

SCENARIO = EXAMPLES["paper"]().with_changes(slots=8, altitude_m=8.0)


def test_who_does_not_move_for_a_while_is_told_once_for_each_while() -> None:
    stillness = Stillness()
    still = [stillness.seen("uav-1", float(now), (0.1 * (now % 2), 0.0, 20.0)) for now in range(40)]
    assert [now for now, one in enumerate(still) if one] == [int(STILL_S), int(2 * STILL_S) + 1]


def test_who_descends_or_was_forgotten_is_not_still() -> None:
    stillness = Stillness()
    assert not any(stillness.seen("uav-1", float(now), (0.0, 0.0, 60.0 - 0.5 * now)) for now in range(100))
    stillness.seen("uav-2", 0.0, (0.0, 0.0, 20.0))
    stillness.forget("uav-2")
    assert not stillness.seen("uav-2", 2 * STILL_S, (0.0, 0.0, 20.0))


@pytest.mark.parametrize("autopilot", list(Autopilot))
def test_one_that_was_left_hovering_lands_after_the_plan_and_an_event_says_so(autopilot: Autopilot) -> None:
    with flight(SCENARIO, autopilots=[autopilot.value]) as flown:
        operation_id = flown.take_off(replanning="off")
        (held,) = flown.run(flown.ground.ask(flown.service.fleet.link.hold([2]))).values()
        assert held.ok, held
        view = flown.ended(operation_id)
        told = [event["data"] for event in flown.events("brought_down")]
    assert (view.state, view.uavs["uav-2"].end) == (State.COMPLETED_PARTLY, UavEnd.RETURNED), view.error
    assert view.uavs["uav-1"].end == UavEnd.FLOWN
    assert [(one["uav_id"], one["action"], one["error"]) for one in told] == [("uav-2", "land", None)]
