"""sim.boot: from power to ready, and what a vehicle says meanwhile"""

from typing import TYPE_CHECKING, Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.sim import Fleet, Reboot, VehicleSpec, VirtualClock, grid_of
from skyfolio.sim.modes import Mode

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.sim.conftest import Bench

HOME = (47.397742, 8.545594)
ACCEPTED, REJECTED, FAILED = 0, 1, 4
GUIDED = 4


def words(bench: "Bench") -> list[tuple[int, str]]:
    """Return severity and text of all the STATUSTEXTs that it has sent."""
    return [(message.severity, message.text) for message in bench.sent if message.get_type() == "STATUSTEXT"]


def built(bench: "Bench", message_id: int) -> Any:
    return bench.autopilot.telemetry.build(message_id)


def test_a_copter_that_was_just_switched_on_does_not_arm_where_it_needs_a_position_for_40_s(
    new_bench: "Callable[..., Bench]",
) -> None:
    copter = new_bench(flavour="ardupilot", booted_s_ago=0.0)
    copter.fly(20.0)
    assert copter.set_mode(GUIDED) == ACCEPTED
    assert copter.command(400, 1.0) == FAILED
    assert copter.command(400, 1.0, 21196.0) == FAILED
    copter.fly(0.1)
    assert words(copter)[-1] == (2, "Arm: Need Position Estimate")
    status = built(copter, dialect.MAVLINK_MSG_ID_SYS_STATUS)
    assert status.onboard_control_sensors_health & dialect.MAV_SYS_STATUS_PREARM_CHECK
    copter.fly(19.8)
    assert copter.command(400, 1.0) == FAILED
    copter.fly(0.2)
    assert copter.command(400, 1.0) == ACCEPTED
    assert (2, "PreArm: Need Position Estimate") in words(copter)
    assert [text for _, text in words(copter) if "is using GPS" in text] == [
        "EKF3 IMU0 is using GPS",
        "EKF3 IMU1 is using GPS",
    ]


def test_a_copter_that_was_just_switched_on_is_nowhere_until_its_origin_is_set(
    new_bench: "Callable[..., Bench]",
) -> None:
    copter = new_bench(flavour="ardupilot", booted_s_ago=0.0)
    assert copter.command(512, 242.0) == FAILED
    copter.fly(16.0)
    assert {message.get_type() for message in copter.sent} == {"HEARTBEAT", "STATUSTEXT"}
    position = built(copter, dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT)
    assert (position.lat, position.lon) == (0, 0)
    copter.fly(1.2)
    assert [message.get_type() for message in copter.sent if message.get_type() == "HOME_POSITION"]
    assert built(copter, dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT).lat == round(HOME[0] * 1e7)
    assert copter.command(512, 242.0) == ACCEPTED


def test_a_fence_wants_a_position_even_in_a_mode_that_does_not(new_bench: "Callable[..., Bench]") -> None:
    copter = new_bench(flavour="ardupilot", booted_s_ago=0.0)
    copter.autopilot.parameters["FENCE_ENABLE"] = 1
    assert copter.command(400, 1.0) == FAILED
    copter.fly(0.1)
    assert words(copter)[-1] == (2, "Arm: Fence enabled, need position estimate")


def test_arming_a_px4_is_rejected_for_now_in_its_first_seconds(new_bench: "Callable[..., Bench]") -> None:
    bench = new_bench(booted_s_ago=0.0)
    assert built(bench, 0).system_status == dialect.MAV_STATE_UNINIT
    assert bench.command(400, 1.0) == REJECTED
    bench.fly(0.1)
    assert "".join(text for _, text in words(bench)) == "Arming denied: Resolve system health failures first\t"
    bench.fly(7.0)
    assert built(bench, 0).system_status == dialect.MAV_STATE_STANDBY
    assert bench.command(400, 1.0) == ACCEPTED


@pytest.mark.parametrize("flavour", ["px4", "ardupilot"])
def test_a_vehicle_that_has_been_on_for_a_minute_arms_at_once_and_has_sent_all_texts(
    new_bench: "Callable[..., Bench]", flavour: str
) -> None:
    bench = new_bench(flavour=flavour)
    bench.fly(1.0)
    assert not words(bench)
    assert built(bench, dialect.MAVLINK_MSG_ID_SYSTEM_TIME).time_boot_ms == pytest.approx(61_000, abs=1)
    assert bench.command(400, 1.0) == ACCEPTED


def test_a_reboot_in_the_air_comes_up_disarmed_and_on_the_ground_while_it_falls() -> None:
    fleet = Fleet(grid_of(1, *HOME, autopilot="ardupilot"), clock=VirtualClock())
    vehicle = fleet.vehicles[1]
    vehicle.autopilot.set_mode(Mode.GUIDED)
    vehicle.autopilot.arm()
    vehicle.autopilot.takeoff(60.0)
    fleet.step_to(60.0)
    fleet.inject(Reboot(1))
    fleet.step_to(63.2)
    assert vehicle.running
    assert vehicle.position[2] > 5.0
    state: Any = vehicle.autopilot.telemetry.build(dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE)
    beat: Any = vehicle.autopilot.telemetry.build(dialect.MAVLINK_MSG_ID_HEARTBEAT)
    assert (state.landed_state, beat.base_mode, beat.custom_mode, beat.system_status) == (1, 81, 0, 3)
    assert vehicle.autopilot.boot_plan.age_s < 1.0
    fleet.step_to(70.0)
    assert not vehicle.alive


def test_how_long_a_vehicle_has_been_on_is_bounded() -> None:
    with pytest.raises(ValueError, match="booted_s_ago must be between 0 and 1000000, got -1"):
        VehicleSpec(1, *HOME, booted_s_ago=-1.0)
