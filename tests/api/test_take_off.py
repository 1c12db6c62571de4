"""What goes wrong before slot 0 ends the launch at once, for everybody, and says who and why."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from skyfolio import sim
from skyfolio.api.flights.operation_views import OperationView, State
from skyfolio.mavlink_bridge import Autopilot
from skyfolio.planner import EXAMPLES
from tests.api.sky import Sky, flight, sky

SCENARIO = EXAMPLES["minimal"]().with_changes(slots=8, altitude_m=40.0)
AT_ONCE_S = 12.0
"""Seconds, of 120 that a launch may take."""
RETURNS_WHEN_LOW = {
    Autopilot.PX4: {"COM_LOW_BAT_ACT": 3.0},
    Autopilot.ARDUPILOT: {"BATT_LOW_MAH": 1000.0, "BATT_FS_LOW_ACT": 2.0},
}


BOTH = pytest.mark.parametrize("autopilot", list(Autopilot))


@contextmanager
def standing(autopilot: Autopilot = Autopilot.PX4) -> Iterator[Sky]:
    """A fleet on the ground whose second vehicle returns when its battery is low."""
    with flight(SCENARIO, autopilots=[autopilot.value]) as flown:
        flown.set_parameters(RETURNS_WHEN_LOW[autopilot], 2)
        yield flown


def ended(flown: Sky, operation_id: str) -> tuple[OperationView, float]:
    """The operation when it is over, and the seconds that took."""
    began_s = flown.now_s
    return flown.ended(operation_id), flown.now_s - began_s


def launched_to(flown: Sky, up_m: float) -> str:
    """An operation whose second vehicle has just climbed so high."""
    operation = flown.client.fly(flown.plan.id)
    flown.wait(lambda: flown.fleet.vehicles[2].position[2] > up_m or is_over(flown, operation.id))
    return operation.id


def is_over(flown: Sky, operation_id: str) -> bool:
    view = flown.client.operation(operation_id)
    assert view.state is not State.FAILED, view.error
    return False


def commands_to(flown: Sky, system_id: int, since_s: float) -> list[str]:
    heard = flown.fleet.truth.messages
    return [
        one.name
        for one in heard
        if one.system_id == system_id
        and one.t_s > since_s
        and one.direction == "in"
        and one.name.startswith(("COMMAND", "MISSION", "SET_"))
    ]


@BOTH
@pytest.mark.parametrize(
    ("fault", "cause"),
    [
        (sim.MotorFailure(2), ("crashed", "disarmed", "landed")),
        (sim.ModeChange(2, "POSITION"), ("not commanded",)),
        (sim.LowBattery(2, 0.06), ("in failsafe", "not commanded")),
        (sim.Mute(2), ("silent for",)),
    ],
    ids=["crash", "human", "battery", "silence"],
)
def test_whoever_falls_out_of_the_climb_ends_it_at_once_by_name_and_the_other_hovers(
    autopilot: Autopilot, fault: sim.Fault, cause: tuple[str, ...]
) -> None:
    with standing(autopilot) as flown:
        operation_id = launched_to(flown, 6.0)
        flown.inject(fault)
        view, seconds = ended(flown, operation_id)
        struck_s = flown.fleet.now_s
        assert view.state is State.FAILED
        assert view.error is not None
        assert "'uav-2'" in view.error
        assert "'uav-1'" not in view.error
        assert any(one in view.error for one in cause), view.error
        assert seconds < AT_ONCE_S
        hold = "HOLD" if autopilot is Autopilot.PX4 else "GUIDED"
        other = flown.fleet.vehicles[1]
        flown.wait(lambda: other.mode.name == hold)
        flown.let_pass(4.0)  # it would be at 40 m
        assert other.armed
        assert 4.0 < other.position[2] < 36.0
        assert commands_to(flown, 2, struck_s) == []


@BOTH
def test_who_is_still_low_when_another_falls_out_lands(autopilot: Autopilot) -> None:
    with standing(autopilot) as flown:
        first = flown.fleet.vehicles[1].autopilot
        first.parameters["MPC_Z_V_AUTO_UP" if autopilot is Autopilot.PX4 else "WPNAV_SPEED_UP"] = (
            0.3 if autopilot is Autopilot.PX4 else 30.0
        )
        operation_id = launched_to(flown, 3.0)
        assert flown.fleet.vehicles[1].position[2] < 2.0
        flown.inject(sim.ModeChange(2, "POSITION"))
        view, _ = ended(flown, operation_id)
        assert view.state is State.FAILED
        flown.wait(lambda: bool(flown.fleet.truth.happened("disarmed", 1)))
        modes = [event.detail["mode"] for event in flown.fleet.truth.happened("mode", 1)]
        assert "LAND" in modes[-2:]  # a disarmed PX4 goes on to the pilot's mode


def test_a_human_who_takes_one_that_waits_at_its_altitude_ends_the_launch() -> None:
    with standing() as flown:
        slow = flown.fleet.vehicles[1].autopilot
        slow.parameters["MPC_Z_V_AUTO_UP"] = 0.5
        operation_id = launched_to(flown, 39.5)
        flown.until(operation_id, lambda view: view.state is State.LAUNCHING)
        flown.wait(lambda: flown.fleet.vehicles[2].mode.name == "HOLD")
        flown.inject(sim.ModeChange(2, "POSITION"))
        view, seconds = ended(flown, operation_id)
        assert view.error is not None
        assert view.error.startswith("lost before slot 0: 'uav-2': human took over: in mode 'position'")
        assert seconds < AT_ONCE_S


def test_how_the_flight_before_ended_does_not_keep_a_uav_on_the_ground() -> None:
    with standing() as flown:
        operation_id = launched_to(flown, 6.0)
        flown.inject(sim.ModeChange(2, "LAND"))
        view, _ = ended(flown, operation_id)
        assert view.state is State.FAILED
        for number in (1, 2):
            flown.inject(sim.ModeChange(number, "LAND"))
            flown.wait(lambda number=number: bool(flown.fleet.truth.happened("disarmed", number)))  # type: ignore[misc]
        flown.wait(lambda: not any(vehicle.armed for vehicle in flown.client.vehicles()))
        again = flown.client.fly(flown.plan.id)
        flown.until(again.id, lambda view: view.state is State.FLYING)
        flown.client.command(again.id, "abort", action="land")


def told(flown: Sky, kind: str) -> list[dict[str, Any]]:
    return [event["data"] for event in flown.events(kind)]


def not_yet(flown: Sky, system_id: int, for_s: float) -> None:
    """This vehicle refuses to be armed for a while, as an ArduCopter does that has just booted."""
    autopilot = flown.fleet.vehicles[system_id].autopilot
    arm, refused_s = autopilot.arm, []

    def refuse(*, force: bool = False) -> bool:
        refused_s.append(flown.now_s)
        if flown.now_s < refused_s[0] + for_s:  # from when it is asked for the first time
            autopilot.send_text("Arm: Need Position Estimate", severity=2)
            return False
        return bool(arm(force=force))

    autopilot.arm = refuse  # type: ignore[method-assign]


@BOTH
def test_one_that_cannot_be_armed_yet_is_waited_for_by_all_on_the_ground_and_its_words_are_told(
    autopilot: Autopilot,
) -> None:
    with standing(autopilot) as flown:
        not_yet(flown, 2, for_s=4.0)
        operation = flown.client.fly(flown.plan.id)
        flown.until(operation.id, lambda _: told(flown, "arming_refused"))
        assert flown.fleet.vehicles[1].position[2] < 0.5
        flown.until(operation.id, lambda view: view.state is State.FLYING)
        refusals = [event for event in told(flown, "arming_refused") if event["uav_id"] == "uav-2"]
        assert "Need Position Estimate" in refusals[0]["because"]
        truth = flown.fleet.truth
        armed_s = max(event.t_s for event in truth.happened("armed", 2))
        assert min(event.t_s for event in truth.happened("takeoff")) >= armed_s
        flown.client.command(operation.id, "abort", action="land")


def test_one_that_has_no_fix_yet_is_waited_for_before_it_is_audited() -> None:
    with standing() as flown:
        flown.inject(sim.GpsLoss(2, for_s=20.0))
        flown.wait(lambda: flown.client.vehicles()[1].lat_deg is None)
        before = len(told(flown, "preflight"))
        operation = flown.client.fly(flown.plan.id)
        flown.until(operation.id, lambda view: view.state in {State.LAUNCHING, State.FLYING})
        assert told(flown, "waiting_for_facts")[-1]["uav_id"] == "uav-2"
        assert not [one for one in told(flown, "preflight")[before:] if one["level"] == "blocker"]
        flown.client.command(operation.id, "abort", action="land")


def test_our_own_id_is_no_vehicle() -> None:
    with sky(SCENARIO) as empty:
        answer = empty.http.post("/v1/fleet/vehicles", json={"uav_id": "uav-9", "system_id": 245})
    assert answer.status_code == 422
    assert "ground station's own" in answer.text
