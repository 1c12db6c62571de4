"""Vehicles that save themselves, that a human holds, or that run low: seen, told with numbers, and left alone."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from skyfolio import sim
from skyfolio.api.client import ApiError
from skyfolio.api.flights.operation_views import OperationView
from skyfolio.mavlink_bridge import Autopilot
from skyfolio.planner import EXAMPLES
from tests.api.sky import Sky, flight

SCENARIO = EXAMPLES["paper"]().with_changes(slots=40, altitude_m=8.0)
PARAMETERS = {
    Autopilot.PX4: {"COM_LOW_BAT_ACT": 3.0, "NAV_DLL_ACT": 2.0, "COM_DL_LOSS_T": 5.0, "COM_FAIL_ACT_T": 1.0},
    Autopilot.ARDUPILOT: {
        "BATT_LOW_MAH": 500.0,
        "BATT_FS_LOW_ACT": 2.0,
        "FS_GCS_ENABLE": 1.0,
        "FS_GCS_TIMEOUT": 5.0,
        "SYSID_MYGCS": 245.0,
    },
}
ORDERS = ("COMMAND", "MISSION", "SET_")
CHANGE_SPEED = 178


PATIENT = {"heartbeat_stale_s": 8.0, "heartbeat_lost_s": 16.0}
"""What counts here is what vehicles say, not that they are silent."""
BOTH = pytest.mark.parametrize("autopilot", list(Autopilot))


@contextmanager
def flying(autopilot: Autopilot = Autopilot.PX4, **options: Any) -> Iterator[tuple[Sky, str]]:
    """A fleet whose failsafes are set, in slot 0."""
    with flight(SCENARIO, autopilots=[autopilot.value], **PATIENT) as flown:
        flown.set_parameters(PARAMETERS[autopilot])
        yield flown, flown.take_off(**options)


def answered(flown: Sky, operation_id: str) -> OperationView:
    return flown.until(operation_id, lambda view: view.recoveries)


def orders_to(flown: Sky, system_id: int, since_s: float) -> set[str | int]:
    """Commands by their numbers, however often each was repeated, and other orders by their names."""
    return {
        one.command or one.name
        for one in flown.fleet.truth.messages
        if one.system_id == system_id and one.t_s > since_s and one.direction == "in" and one.name.startswith(ORDERS)
    }


def assert_left_alone_and_planned_around(
    flown: Sky, operation_id: str, view: OperationView, kind: str, seen_s: float
) -> None:
    """UAV 3 is lost for that reason; the others fly a new plan, nobody commands it, and its air is kept.

    The one thing it may be told is its own speed, where it left the plan at one of ours; that is an event.
    """
    report = view.recoveries[0]
    assert (report.cause, report.outcome, view.lost) == (kind, "flying", ["uav-3"])
    assert set(report.vehicles) == {"uav-1", "uav-2"}
    operation = flown.service.operations.active(operation_id)
    assert operation is not None
    assert "uav-3" in operation.flight.guidance.airspace.ghosts
    flown.let_pass(4.0)
    orders = orders_to(flown, 3, seen_s)
    restored = [one for one in flown.told(operation_id, "speed_restored") if one["uav_id"] == "uav-3"]
    assert orders <= ({CHANGE_SPEED} if restored else set())


@BOTH
def test_a_battery_failsafe_in_flight_is_told_with_its_words_and_numbers_and_left_alone(autopilot: Autopilot) -> None:
    with flying(autopilot) as (flown, operation_id):
        flown.inject(sim.LowBattery(3, 0.06))
        view = answered(flown, operation_id)
        seen_s = flown.fleet.now_s
        (lost,) = flown.told(operation_id, "uav_lost")
        mode = "hold" if autopilot is Autopilot.PX4 else "return"  # PX4 holds for COM_FAIL_ACT_T first
        assert lost["cause"] == "in_failsafe"
        assert f"in mode '{mode}', system status 5" in lost["detail"]
        assert "% of charge left" in lost["detail"]
        assert_left_alone_and_planned_around(flown, operation_id, view, "in_failsafe", seen_s)


@BOTH
def test_a_uav_that_its_failsafe_brought_home_has_landed_there_and_not_crashed(autopilot: Autopilot) -> None:
    with flying(autopilot) as (flown, operation_id):
        flown.inject(sim.LowBattery(3, 0.06))
        end = flown.ended(operation_id)
        assert (end.lost, end.uavs["uav-3"].end) == (["uav-3"], "returned")


@BOTH
def test_a_uav_that_hears_us_no_more_and_saves_itself_is_seen_and_left_alone(autopilot: Autopilot) -> None:
    with flying(autopilot) as (flown, operation_id):
        flown.inject(sim.Impair(3, up=sim.Impairments(cut=True)))
        view = answered(flown, operation_id)
        seen_s = flown.fleet.now_s
        (lost,) = flown.told(operation_id, "uav_lost")
        assert (lost["cause"], "system status 5" in lost["detail"]) == ("in_failsafe", True), lost
        flown.inject(sim.Impair(3, up=sim.Impairments()))  # it hears us again, and returns on
        flown.let_pass(6.0)
        assert_left_alone_and_planned_around(flown, operation_id, view, "in_failsafe", seen_s)


def test_a_px4_that_somebody_else_holds_is_seen_and_left_alone() -> None:
    with flying() as (flown, operation_id):
        flown.client.command(operation_id, "pause")
        flown.let_pass(8.0)
        assert flown.client.operation(operation_id).lost == []  # our own hold is nobody else's
        flown.client.command(operation_id, "resume")
        flown.let_pass(4.0)
        flown.inject(sim.ModeChange(3, "HOLD"))
        view = answered(flown, operation_id)
        seen_s = flown.fleet.now_s
        (lost,) = flown.told(operation_id, "uav_lost")
        assert lost["cause"] == "human_took_over"
        assert "held by somebody else, not by this service: its last order was 'mission'" in lost["detail"]
        assert_left_alone_and_planned_around(flown, operation_id, view, "human_took_over", seen_s)
        assert flown.fleet.vehicles[3].mode is sim.Mode.HOLD


def test_a_low_battery_is_offered_and_only_the_operator_sends_the_uav_home() -> None:
    with flying() as (flown, operation_id):
        flown.inject(sim.LowBattery(3, 0.18))
        view = flown.until(operation_id, lambda view: view.low_on_battery)
        flown.let_pass(4.0)
        assert (view.low_on_battery, view.lost) == (["uav-3"], [])
        assert flown.client.operation(operation_id).recoveries == []  # nobody is grabbed
        (offer,) = flown.told(operation_id, "uav_low_on_battery")
        assert (offer["uav_id"], offer["offer"]) == ("uav-3", "retire")
        assert "18% of charge left" in offer["detail"]
        with pytest.raises(ApiError, match="409"):
            flown.client.command(operation_id, "retire", uav_id="uav-9")
        flown.client.command(operation_id, "retire", uav_id="uav-3")
        sent_s = flown.fleet.now_s
        view = answered(flown, operation_id)
        assert_left_alone_and_planned_around(flown, operation_id, view, "battery", sent_s)
        assert flown.fleet.vehicles[3].mode is sim.Mode.RTL
        with pytest.raises(ApiError, match="409"):
            flown.client.command(operation_id, "retire", uav_id="uav-3")
        flown.until(operation_id, lambda _: flown.told(operation_id, "ghost_released"))


@BOTH
def test_a_reboot_in_flight_is_a_loss(autopilot: Autopilot) -> None:
    with flying(autopilot) as (flown, operation_id):
        flown.inject(sim.Reboot(3, for_s=1.0))
        view = answered(flown, operation_id)
        assert view.lost == ["uav-3"]
        assert view.recoveries[0].cause in {
            "rebooted",
            "crashed",
            "disarmed_in_air",
        }  # never landed: its motors have stopped


def test_a_uav_that_restarts_and_proves_that_it_flies_on_is_an_event_and_no_loss() -> None:
    with flying() as (flown, operation_id):
        flown.inject(sim.ClockJump(3, -flown.fleet.now_s - sim.BOOTED_S_AGO))
        flown.until(
            operation_id,
            lambda _: [one for one in flown.told(operation_id, "condition") if one["after"] == "rebooted"],
        )
        flown.let_pass(4.0)
        view = flown.client.operation(operation_id)
        assert (view.lost, view.recoveries) == ([], [])
        (event,) = [one for one in flown.told(operation_id, "condition") if one["after"] == "rebooted"]
        assert "it flies its mission on" in event["cause"]
