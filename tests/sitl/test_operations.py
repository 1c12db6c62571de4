"""Whole operations with autopilots that somebody has running, and what may happen to them: see docs/sitl.md.

SITL_URL=tcpout://127.0.0.1:5760,tcpout://127.0.0.1:5770 make test-sitl

In the order of how much is left of the fleet afterwards: the last test kills an autopilot.
"""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from skyfolio.api.flights.operation_views import OperationView, State
from skyfolio.mavlink_bridge import Autopilot
from tests.sitl.field import MARKS, PIDS, Field, Standing, field_of

pytestmark = MARKS
DECLARED_WITHIN_S = 5.5
ANSWERED_WITHIN_S = 30.0
TOLD_WITHIN_S = 60.0
GPS, BATTERY, MOTOR = 4.0, 100.0, 101.0
"""FAILURE_UNIT."""


@pytest.fixture
def flown(tmp_path: Path) -> Iterator[Field]:
    with field_of(tmp_path) as made:
        yield made


def lost(flown: Field, operation_id: str, uav: str, within_s: float = TOLD_WITHIN_S) -> str:
    """The cause for which this UAV was declared lost."""
    flown.until(operation_id, lambda view: uav in view.lost, within_s)
    (event,) = [event for event in flown.events("uav_lost") if event["uav_id"] == uav]
    print(f"{uav}: {event['cause']}: {event['detail']}")  # noqa: T201
    return str(event["cause"])


def answered(flown: Field, operation_id: str, uav: str) -> None:
    """The others, if there are any, fly a new plan."""
    others = {one.uav for one in flown.vehicles} - {uav}
    if others:
        view = flown.until(operation_id, lambda view: view.recoveries, ANSWERED_WITHIN_S)
        assert [(report.outcome, set(report.vehicles)) for report in view.recoveries] == [("flying", others)]


def ends(view: OperationView) -> dict[str, str]:
    return {uav: str(one.end) for uav, one in view.uavs.items()}


def all_flown(flown: Field, operation_id: str) -> None:
    view = flown.ended(operation_id)
    assert (view.state, view.error, view.lost) == (State.COMPLETED, None, [])
    assert ends(view) == {one.uav: "flown" for one in flown.vehicles}


def test_everybody_flies_the_plan_to_its_end(flown: Field) -> None:
    operation_id = flown.take_off()
    all_flown(flown, operation_id)
    slips = [event["distance_m"] for event in flown.events("slip")]
    assert len(slips) >= len(flown.vehicles) * 5
    assert sum(slips) / len(slips) < 5.0
    assert max(slips) < 15.0


def test_a_service_that_is_killed_and_started_again_flies_on(flown: Field) -> None:
    operation_id = flown.take_off()
    flown.at_slot(operation_id, 3)
    flown.signal(signal.SIGKILL)
    time.sleep(2.0)
    flown.start()
    all_flown(flown, operation_id)


def test_a_service_that_stands_still_for_a_while_has_lost_nobody(flown: Field) -> None:
    operation_id = flown.take_off()
    flown.at_slot(operation_id, 3)
    flown.signal(signal.SIGSTOP)
    time.sleep(8.0)
    flown.signal(signal.SIGCONT)
    all_flown(flown, operation_id)


def test_whoever_another_station_holds_is_left_to_it(flown: Field) -> None:
    operation_id, taken = flown.take_off(), flown.vehicles[-1]
    flown.at_slot(operation_id, 3)
    flown.station.hold(taken)
    assert lost(flown, operation_id, taken.uav) == "human_took_over"
    answered(flown, operation_id, taken.uav)
    flown.station.land(taken)
    view = flown.ended(operation_id)
    assert ends(view)[taken.uav] == "landed_elsewhere"
    assert all(ends(view)[one.uav] == "flown" for one in flown.vehicles[:-1])


def test_whoever_another_station_sends_home_is_waited_for_and_has_returned(flown: Field) -> None:
    operation_id, taken = flown.take_off(), flown.vehicles[-1]
    flown.at_slot(operation_id, 4)
    flown.station.return_home(taken)
    assert lost(flown, operation_id, taken.uav) in {"human_took_over", "in_failsafe"}
    answered(flown, operation_id, taken.uav)
    view = flown.ended(operation_id)
    assert ends(view)[taken.uav] == "returned"
    assert all(ends(view)[one.uav] == "flown" for one in flown.vehicles[:-1])


Strike = Callable[[Field, Standing], bool]
"""Lets something happen to a vehicle; False if it cannot be told to."""


def injected(unit: float) -> Strike:
    """PX4 lets a part fail by MAV_CMD_INJECT_FAILURE, when SYS_FAILURE_EN allows it."""

    def strike(flown: Field, one: Standing) -> bool:
        return flown.fail(one, unit)

    return strike


def told(*choices: dict[str, float]) -> Strike:
    """Set all parameters of the first choice that the vehicle knows."""

    def strike(flown: Field, one: Standing) -> bool:
        return any(all(flown.set(one, name, value) for name, value in choice.items()) for choice in choices)

    return strike


PX4, ARDUPILOT = Autopilot.PX4, Autopilot.ARDUPILOT
STRIKES: dict[str, tuple[dict[Autopilot, Strike], set[str]]] = {
    "low battery": (
        {PX4: injected(BATTERY), ARDUPILOT: told({"BATT_FS_LOW_ACT": 2, "BATT_LOW_MAH": 100_000})},
        {"in_failsafe", "crashed"},
    ),
    "fence breach": (
        {
            PX4: told({"GF_ACTION": 3, "GF_MAX_HOR_DIST": 5}),
            ARDUPILOT: told({"FENCE_ACTION": 1, "FENCE_RADIUS": 5, "FENCE_ENABLE": 1}),
        },
        {"in_failsafe"},
    ),
    "no satellites": (
        {PX4: injected(GPS), ARDUPILOT: told({"SIM_GPS1_ENABLE": 0}, {"SIM_GPS_DISABLE": 1})},
        {"in_failsafe", "landed", "crashed"},
    ),
    "motor failure": (
        {PX4: injected(MOTOR), ARDUPILOT: told({"SIM_ENGINE_MUL": 0, "SIM_ENGINE_FAIL": 1})},
        {"crashed", "landed", "in_failsafe"},
    ),
}


@pytest.mark.parametrize("name", STRIKES)
def test_whoever_something_happens_to_is_named_with_its_cause_and_the_others_fly_on(flown: Field, name: str) -> None:
    strikes, causes = STRIKES[name]
    operation_id, struck = flown.take_off(), flown.vehicles[-1]
    if name == "low battery" and struck.autopilot is PX4:
        assert flown.set(struck, "COM_LOW_BAT_ACT", 3)
    flown.at_slot(operation_id, 4)
    if not strikes[struck.autopilot](flown, struck):
        pytest.skip(f"{struck.uav} cannot be told to have a {name}")
    assert lost(flown, operation_id, struck.uav) in causes
    answered(flown, operation_id, struck.uav)
    if len(flown.vehicles) > 1:
        view = flown.ended(operation_id)
        assert all(ends(view)[one.uav] == "flown" for one in flown.vehicles[:-1])
        assert ends(view)[struck.uav] in {"returned", "landed_elsewhere", "lost"}


def needs_process(flown: Field) -> Standing:
    """A vehicle whose process is known, of a fleet that can lose it."""
    known = [one for one in flown.vehicles if one.system_id in PIDS]
    if not known or len(flown.vehicles) < 2:
        pytest.skip("SITL_PIDS names no process, or there is only one vehicle")
    return known[-1]


def test_an_autopilot_that_stands_still_for_a_while_is_lost_and_offered_again(flown: Field) -> None:
    struck = needs_process(flown)
    operation_id = flown.take_off()
    flown.at_slot(operation_id, 3)
    os.kill(PIDS[struck.system_id], signal.SIGSTOP)
    time.sleep(8.0)
    os.kill(PIDS[struck.system_id], signal.SIGCONT)
    assert lost(flown, operation_id, struck.uav) == "heartbeat_lost"
    flown.until(operation_id, lambda view: struck.uav in view.returned, ANSWERED_WITHIN_S)
    answered(flown, operation_id, struck.uav)
    assert flown.ended(operation_id).state is State.COMPLETED


def test_an_autopilot_that_is_killed_is_lost_in_time_and_the_others_complete_a_new_plan(flown: Field) -> None:
    struck = needs_process(flown)
    operation_id = flown.take_off()
    flown.at_slot(operation_id, 5)
    os.kill(PIDS[struck.system_id], signal.SIGKILL)
    killed_s = time.monotonic()
    flown.until(operation_id, lambda view: struck.uav in view.lost, TOLD_WITHIN_S)
    declared_s = time.monotonic() - killed_s
    answered(flown, operation_id, struck.uav)
    print(f"declared after {declared_s:.2f} s, answered after {time.monotonic() - killed_s:.2f} s")  # noqa: T201
    assert declared_s < DECLARED_WITHIN_S
    view = flown.ended(operation_id)
    assert (view.state, ends(view)[struck.uav]) == (State.COMPLETED, "lost")
