"""How UAVs and their operation end: flown means flown, and in the air is not down."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from skyfolio import sim
from skyfolio.api.flights.ends import LastSeen, UavEnd, end_of, shortfall
from skyfolio.api.flights.losses import Loss
from skyfolio.api.flights.operation_views import State
from skyfolio.mavlink_bridge import FlightMode
from skyfolio.planner import EXAMPLES
from tests.api.sky import flight

HOME = (10.0, 20.0)
FAILSAFE = Loss("in_failsafe", "in mode 'return'")
SILENT = Loss("heartbeat_lost", "silent for 5.0 s", 5.0)
CRASHED = Loss("crashed", "sinking at 9 m/s")
RETIRED = Loss("battery", "sent home by the operator: no low battery")
SCENARIO = EXAMPLES["minimal"]().with_changes(slots=6, altitude_m=20.0)


def seen(**changes: Any) -> LastSeen:
    """On the ground at its home."""
    known: dict[str, Any] = {
        "heard": True,
        "armed": False,
        "up_m": 0.1,
        "mode": "hold",
        "at_m": HOME,
        "returns_m": (HOME,),
    }
    return LastSeen(**known | changes)


@pytest.mark.parametrize(
    ("last", "loss", "end"),
    [
        (seen(at_m=(80.0, 20.0)), None, UavEnd.FLOWN),
        (seen(at_m=(80.0, 20.0), heard=False), None, UavEnd.FLOWN),
        (seen(armed=True, up_m=60.0, mode="return"), None, UavEnd.IN_THE_AIR),
        (seen(armed=True, up_m=60.0, mode="return"), FAILSAFE, UavEnd.IN_THE_AIR),
        (seen(), FAILSAFE, UavEnd.RETURNED),
        (seen(at_m=(12.0, 29.0)), SILENT, UavEnd.RETURNED),
        (seen(), RETIRED, UavEnd.RETURNED),
        (seen(at_m=(300.0, 22.0), returns_m=(HOME, (300.0, 20.0))), FAILSAFE, UavEnd.RETURNED),
        (seen(at_m=(40.0, 20.0)), FAILSAFE, UavEnd.LANDED_ELSEWHERE),
        (seen(at_m=None), FAILSAFE, UavEnd.LANDED_ELSEWHERE),
        (seen(armed=True, up_m=60.0, heard=False), SILENT, UavEnd.LOST),
        (seen(at_m=HOME), CRASHED, UavEnd.LOST),
        (seen(at_m=HOME), Loss("disarmed_in_air", "disarmed at 10.1 m"), UavEnd.LOST),
        (seen(up_m=55.0), Loss("rebooted", "its clock runs backwards"), UavEnd.LOST),
        (None, SILENT, UavEnd.LOST),
        (None, None, UavEnd.LOST),
        (seen(at_m=(90.0, 20.0), ends_m=((80.0, 20.0),)), None, UavEnd.FLOWN),
        (seen(at_m=None, ends_m=((80.0, 20.0),)), None, UavEnd.FLOWN),
        (seen(ends_m=((80.0, 20.0),)), None, UavEnd.RETURNED),
        (seen(at_m=(50.0, 20.0), ends_m=((80.0, 20.0),)), None, UavEnd.LANDED_ELSEWHERE),
        (seen(at_m=(50.0, 20.0), up_m=5.0, ends_m=((80.0, 20.0),)), None, UavEnd.LANDED_ELSEWHERE),
        (seen(ends_m=((80.0, 20.0), HOME)), None, UavEnd.FLOWN),
    ],
)
def test_each_uav_ends_as_it_was_last_seen(last: LastSeen | None, loss: Loss | None, end: UavEnd) -> None:
    assert end_of(last, loss) is end


class Fleet:
    """A flight that is over, of UAVs as they were last seen, and the losses among them."""

    def __init__(self, counted: list[str], **uavs: tuple[LastSeen | None, Loss | None]) -> None:
        self.systems = {uav: number for number, uav in enumerate(uavs, 1)}
        self.plan = SimpleNamespace(scenario=SimpleNamespace(uav_ids=counted))
        self._seen = {uav: one for uav, (one, _) in uavs.items()}
        self._losses = {uav: loss for uav, (_, loss) in uavs.items()}
        self.roster = self
        self.retired = {uav for uav, loss in self._losses.items() if loss is RETIRED}

    def elapsed_s(self) -> float:
        return 100.0

    def left_its_plan(self, uav: str) -> Loss | None:
        return self._losses[uav]

    def is_heard(self, uav: str) -> bool:
        one = self._seen[uav]
        return one is not None and one.heard

    def last_seen_m(self, uav: str) -> Any:
        one = self._seen[uav]
        return None if one is None else one.at_m

    def landing_m(self, _uav: str) -> tuple[tuple[float, float], ...]:
        return (HOME,)

    def ends_m(self, uav: str) -> Any:
        one = self._seen[uav]
        return () if one is None else one.ends_m

    def telemetry(self, uav: str) -> Any:
        one = self._seen[uav]
        return one and SimpleNamespace(armed=one.armed, relative_alt_m=one.up_m, mode=FlightMode(one.mode))


def why(counted: list[str], **uavs: tuple[LastSeen | None, Loss | None]) -> str | None:
    return shortfall(Fleet(counted, **uavs))  # type: ignore[arg-type]


def test_an_operation_is_completed_when_everybody_its_last_plan_counts_has_flown() -> None:
    assert why(["a", "b"], a=(seen(), None), b=(seen(), None)) is None
    assert why(["a"], a=(seen(), None), b=(None, SILENT)) is None  # a loss that was answered
    assert why(["a", "b"], a=(seen(), None), b=(seen(), RETIRED)) is None


def test_one_that_was_sent_home_by_order_and_did_not_come_down_is_named() -> None:
    assert why(["a", "b"], a=(seen(), None), b=(seen(armed=True, up_m=30.0, heard=False), RETIRED)) == (
        "b lost (battery: sent home by the operator: no low battery)"
    )


def test_whoever_went_home_while_nobody_was_heard_is_named() -> None:
    far = ((80.0, 20.0),)
    assert why(["a", "b"], a=(seen(at_m=far[0], ends_m=far), None), b=(seen(ends_m=far), None)) == "b returned"


def test_whoever_the_last_plan_counts_and_went_home_is_named() -> None:
    assert why(["a", "b", "c"], a=(seen(), None), b=(seen(), FAILSAFE), c=(None, SILENT)) == (
        "b returned (in failsafe: in mode 'return'); c lost (heartbeat lost: silent for 5.0 s)"
    )


def test_whoever_is_in_the_air_is_named_although_no_plan_counts_on_it() -> None:
    up = seen(armed=True, up_m=60.0, mode="return")
    assert why(["a"], a=(seen(), None), b=(up, FAILSAFE)) == (
        "b in the air at 60 m in mode 'return' (in failsafe: in mode 'return')"
    )


def test_an_operation_waits_for_one_that_returns_and_is_completed_in_part_only() -> None:
    with flight(SCENARIO, heartbeat_lost_s=15.0) as flown:
        operation_id = flown.take_off(replanning="off")
        flown.let_pass(4 * SCENARIO.slot_duration_s)  # in the air when the others are down
        flown.fleet.vehicles[2].autopilot.parameters["MPC_Z_V_AUTO_DN"] = 0.5
        flown.inject(sim.ModeChange(2, "RTL"))
        view = flown.until(operation_id, lambda view: view.state in {State.COMPLETED, State.COMPLETED_PARTLY})
        assert [event.system_id for event in flown.fleet.truth.happened("landed")] == [1, 2]
        assert not flown.fleet.vehicles[2].armed
        assert {uav: one.end for uav, one in view.uavs.items()} == {"uav-1": "flown", "uav-2": "returned"}
        assert view.state is State.COMPLETED_PARTLY
        assert view.error is not None
        assert view.error.startswith("uav-2 returned (")
