"""sim.failsafes: the vehicle's own answers to a lost ground station, a fence, and an empty battery"""

from typing import TYPE_CHECKING, Any

import pytest

from skyfolio.sim.modes import Mode

if TYPE_CHECKING:
    from tests.sim.conftest import Bench, Items

GCS = (6, 8, 0, 0, 4, 3)
"""HEARTBEAT of a ground station: type, autopilot, base mode, custom mode, state, version."""


def wait(bench: "Bench", seconds: float) -> None:
    """Let fleet time and the ground station's time pass together."""
    for _ in range(round(seconds / 0.5)):
        bench.wall_s += 0.5
        bench.fly(0.5)


def words(bench: "Bench") -> list[tuple[int, str]]:
    """Return severity and text of all the STATUSTEXTs that it has sent."""
    return [(message.severity, message.text) for message in bench.sent if message.get_type() == "STATUSTEXT"]


def status(bench: "Bench") -> int:
    """Return HEARTBEAT.system_status."""
    message: Any = bench.autopilot.telemetry.build(0)
    return int(message.system_status)


def beat(bench: "Bench") -> None:
    bench.ask("heartbeat", *GCS)


@pytest.mark.parametrize(("action", "mode"), [(0, Mode.HOLD), (1, Mode.HOLD), (2, Mode.RTL), (3, Mode.LAND)])
def test_px4_holds_first_and_then_does_what_its_parameter_says(airborne: "Bench", action: int, mode: Mode) -> None:
    airborne.autopilot.parameters["NAV_DLL_ACT"] = action
    beat(airborne)
    wait(airborne, 14.0)
    assert airborne.autopilot.mode.name == "HOLD"
    wait(airborne, 2.0)
    assert airborne.autopilot.mode is mode


def test_px4_returns_on_although_the_ground_station_is_back_until_a_mode_is_chosen(
    airborne: "Bench", items: "Items"
) -> None:
    airborne.autopilot.parameters["NAV_DLL_ACT"] = 2
    airborne.upload(items.waypoint(500.0, 0.0, current=1.0))
    airborne.set_mode(4)
    beat(airborne)
    wait(airborne, 11.0)
    assert airborne.autopilot.mode.name == "HOLD"
    wait(airborne, 6.0)
    assert airborne.autopilot.mode.name == "RTL"
    beat(airborne)
    wait(airborne, 1.0)
    assert airborne.autopilot.mode.name == "RTL"
    assert status(airborne) == 5
    assert airborne.set_mode(4) == 0
    assert status(airborne) == 4
    assert words(airborne)[-6:] == [
        (6, "Connection to ground station lost\t"),
        (2, "Failsafe activated: entering Hold for 5 seconds\t"),
        (2, "Failsafe activated\t"),
        (6, "RTL: start return at 518 m (30 m above destination"),
        (6, ")\t"),
        (6, "GCS connection regained\t"),
    ]


def test_a_ground_station_that_never_sent_is_not_missed(airborne: "Bench") -> None:
    airborne.autopilot.parameters["NAV_DLL_ACT"] = 3
    wait(airborne, 60.0)
    assert airborne.autopilot.mode.name == "HOLD"


def test_ardupilot_returns_and_stays_in_its_failsafe(copter_up: "Bench") -> None:
    copter_up.autopilot.parameters["FS_GCS_ENABLE"] = 1
    copter_up.autopilot.parameters["SYSID_MYGCS"] = 245
    beat(copter_up)
    wait(copter_up, 4.0)
    assert copter_up.autopilot.mode.name == "GUIDED"
    wait(copter_up, 2.0)
    assert copter_up.autopilot.mode.name == "RTL"
    state: Any = copter_up.autopilot.telemetry.build(0)
    assert state.system_status == 5
    beat(copter_up)
    wait(copter_up, 1.0)
    assert copter_up.autopilot.mode.name == "RTL"


def test_ardupilot_listens_to_its_own_ground_station_only(copter_up: "Bench") -> None:
    copter_up.autopilot.parameters["FS_GCS_ENABLE"] = 1
    beat(copter_up)
    wait(copter_up, 20.0)
    assert copter_up.autopilot.mode.name == "GUIDED"


def test_ardupilot_can_be_set_to_go_on_in_auto(copter: "Bench", items: "Items") -> None:
    for name, value in (("FS_GCS_ENABLE", 1), ("FS_OPTIONS", 2), ("SYSID_MYGCS", 245), ("AUTO_OPTIONS", 3)):
        copter.autopilot.parameters[name] = value
    copter.upload(items.waypoint(0.0, 0.0), items.add(22), items.waypoint(500.0, 0.0))
    copter.set_mode(3)
    copter.command(400, 1.0)
    beat(copter)
    wait(copter, 25.0)
    assert copter.autopilot.mode.name == "MISSION"
    assert not [kind for kind in copter.kinds() if kind == "failsafe"]
    assert status(copter) == 5
    assert (4, "GCS Failsafe - Continuing Auto Mode") in words(copter)
    beat(copter)
    wait(copter, 1.0)
    assert status(copter) == 4
    assert words(copter)[-1] == (4, "GCS Failsafe Cleared")


def test_an_ardupilot_on_the_ground_reports_the_loss_too(copter: "Bench") -> None:
    copter.autopilot.parameters["FS_GCS_ENABLE"] = 1
    copter.autopilot.parameters["SYSID_MYGCS"] = 245
    beat(copter)
    wait(copter, 6.0)
    assert (status(copter), copter.autopilot.armed) == (5, False)
    assert words(copter) == [(4, "GCS Failsafe")]


@pytest.mark.parametrize(
    ("value", "mode"), [(0, Mode.RTL), (1, Mode.RTL), (2, Mode.RTL), (3, Mode.RTL), (4, Mode.LAND), (5, Mode.HOLD)]
)
def test_px4_without_a_remote_control_obeys_com_obl_rc_act_when_setpoints_end(
    airborne: "Bench", value: int, mode: Mode
) -> None:
    airborne.autopilot.parameters["COM_OBL_RC_ACT"] = value
    airborne.ask("set_position_target_local_ned", 0, 1, 1, 1, 0b0000_1111_1111_1000, 30.0, 0.0, -20.0, *[0.0] * 8)
    assert airborne.command(176, 1.0, 6.0) == 0
    airborne.fly(1.3)
    assert airborne.autopilot.mode is mode
    assert status(airborne) == 5
    assert (2, "Failsafe activated\t") in words(airborne)


def test_px4_goes_on_in_offboard_when_the_setpoints_are_back(airborne: "Bench") -> None:
    point = (0, 1, 1, 1, 0b0000_1111_1111_1000, 30.0, 0.0, -20.0, *[0.0] * 8)
    airborne.ask("set_position_target_local_ned", *point)
    assert airborne.command(176, 1.0, 6.0) == 0
    airborne.fly(3.0)
    assert airborne.autopilot.mode is Mode.RTL
    airborne.ask("set_position_target_local_ned", *point)
    airborne.fly(0.1)
    assert (airborne.autopilot.mode, status(airborne)) == (Mode.GUIDED, 4)


def test_an_arducopters_battery_failsafe_reports_the_charge_and_stays_on(copter_up: "Bench") -> None:
    copter_up.autopilot.parameters["BATT_LOW_MAH"] = 1000.0
    copter_up.autopilot.parameters["BATT_FS_LOW_ACT"] = 2
    copter_up.autopilot.component_failures.set_battery(0.19)
    copter_up.fly(0.1)
    low, announced = words(copter_up)[-2:]
    assert (low[0], low[1].split(" used")[1], announced) == (4, " 4050 mAh", (4, "Battery Failsafe"))
    assert low[1].startswith("Battery 1 is low 14.")
    assert copter_up.autopilot.mode is Mode.RTL
    copter_up.set_mode(4)
    assert status(copter_up) == 5


def test_an_arducopter_without_a_position_lands_and_reports_it(copter_up: "Bench") -> None:
    copter_up.autopilot.component_failures.lose_satellites()
    copter_up.fly(30.0)
    assert words(copter_up)[-2:] == [(2, "EKF variance"), (2, "EKF Failsafe: changed to LAND Mode")]
    state: Any = copter_up.autopilot.telemetry.build(0)
    assert state.base_mode == 209
    assert (copter_up.autopilot.mode, status(copter_up)) == (Mode.LAND, 5)
    assert copter_up.set_mode(4) == 4
    assert words(copter_up.__class__(sent=copter_up.autopilot.due()))[-1] == (
        4,
        "Mode change to GUIDED failed: requires position",
    )
    copter_up.autopilot.component_failures.regain_satellites()
    copter_up.fly(0.1)
    assert words(copter_up)[-1] == (2, "EKF Failsafe Cleared")


def test_a_battery_that_runs_down_in_flight_lands_an_ardupilot_in_time(copter_up: "Bench") -> None:
    copter_up.autopilot.parameters["BATT_LOW_MAH"] = 4800.0
    copter_up.autopilot.parameters["BATT_FS_LOW_ACT"] = 1
    assert copter_up.autopilot.battery.share > 0.97
    seconds = copter_up.fly_until(lambda: copter_up.autopilot.mode.name == "LAND")
    assert 10.0 < seconds < 90.0


def test_a_hover_empties_the_battery_in_about_22_minutes(airborne: "Bench") -> None:
    """18 minutes for 80 % of it, as the airframe's maker has it."""
    before = airborne.autopilot.battery.share
    airborne.fly(108.0)
    assert before - airborne.autopilot.battery.share == pytest.approx(0.08, abs=0.002)


def test_a_ceiling_brings_an_ardupilot_home(copter_up: "Bench") -> None:
    for name, value in (("FENCE_ENABLE", 1), ("FENCE_ALT_MAX", 30.0), ("FENCE_TYPE", 1)):
        copter_up.autopilot.parameters[name] = value
    copter_up.autopilot.navigator.go_to(None, None, 60.0, 0.0)
    copter_up.fly(20.0)
    assert copter_up.autopilot.mode.name == "RTL"
    assert [d for _, kind, d in copter_up.events if kind == "failsafe"] == [{"cause": "fence", "action": "RETURN"}]
    assert (5, "Max Alt fence breached") in words(copter_up)


def test_px4_leaves_offboard_when_the_setpoints_stop_and_is_well_once_it_flies_a_mission(
    airborne: "Bench", items: "Items"
) -> None:
    airborne.upload(items.waypoint(500.0, 0.0, current=1.0))
    mask = 0b0000_1111_1111_1000
    point = (0, 1, 1, 1, mask, 30.0, 0.0, -20.0, *[0.0] * 8)
    assert airborne.command(176, 1.0, 6.0) == 1
    airborne.ask("set_position_target_local_ned", *point)
    assert airborne.command(176, 1.0, 6.0) == 0
    for _ in range(20):
        airborne.ask("set_position_target_local_ned", *point)
        airborne.fly(0.5)
    assert airborne.autopilot.mode.name == "GUIDED"
    assert airborne.autopilot.body.distance_to(0.0, 30.0) < 1.0
    airborne.fly(2.0)
    assert airborne.autopilot.mode.name != "GUIDED"
    assert airborne.autopilot.failsafes.active
    airborne.set_mode(4)
    airborne.fly(1.0)
    assert airborne.autopilot.mode is Mode.MISSION
    assert not airborne.autopilot.failsafes.active
