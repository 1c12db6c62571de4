"""The audit, the model it reads, and the parameters both are made of."""

from __future__ import annotations

import random
import struct
from dataclasses import replace
from typing import Any

import pytest

from skyfolio.api.lab.virtual_wire import fields_of, incoming
from skyfolio.mavlink_bridge import Autopilot, model_from_parameters
from skyfolio.mavlink_bridge.ardupilot import ARDUCOPTER_MODEL as ARDUCOPTER
from skyfolio.mavlink_bridge.findings import Facts, Level, Needs
from skyfolio.mavlink_bridge.parameters import ParameterRead, parameter_value
from skyfolio.mavlink_bridge.preflight import audit
from skyfolio.mavlink_bridge.profiles import profile_of
from skyfolio.mavlink_bridge.px4 import PX4_MODEL as PX4
from skyfolio.sim import VehicleSpec
from skyfolio.sim.autopilot import Autopilot as SimAutopilot

NEEDS = Needs(
    path_m=[(0.0, 0.0), (20.0, 0.0), (40.0, 0.0)],
    slot_s=5.0,
    altitude_m=60.0,
    max_speed_mps=5.0,
    items=20,
    max_items=200,
)
GOOD_PX4 = {"COM_DL_LOSS_T": 10, "NAV_DLL_ACT": 2, "COM_LOW_BAT_ACT": 3, "GF_ACTION": 2, "COM_OBL_RC_ACT": 5}
GOOD_ARDUPILOT = {
    "SYSID_MYGCS": 245, "FS_GCS_ENABLE": 1, "FS_GCS_TIMEOUT": 5, "FS_OPTIONS": 2, "MIS_RESTART": 0,
    "BATT_FS_LOW_ACT": 2, "FENCE_ENABLE": 1, "FENCE_RADIUS": 300, "FENCE_ALT_MAX": 100,
}  # fmt: skip


def facts(autopilot: Autopilot, **changes: Any) -> Facts:
    """A vehicle that is ready in every way, changed."""
    good = Facts(
        autopilot=autopilot,
        parameters=GOOD_PX4 if autopilot is Autopilot.PX4 else GOOD_ARDUPILOT,
        model=PX4 if autopilot is Autopilot.PX4 else replace(ARDUCOPTER, jerk_mps3=5.0),
        at_m=(0.0, 0.0),
        home_m=(0.0, 0.0),
        gps_fix=3,
        satellites=14,
        battery=0.9,
        mav_type=2,
    )
    return replace(good, **changes)


def with_parameter(autopilot: Autopilot, name: str, value: float) -> Facts:
    good = facts(autopilot)
    return replace(good, parameters={**good.parameters, name: value})


@pytest.mark.parametrize("autopilot", list(Autopilot))
def test_a_vehicle_that_is_ready_has_no_findings(autopilot: Autopilot) -> None:
    assert audit(facts(autopilot), NEEDS) == []


@pytest.mark.parametrize(
    ("autopilot", "name", "value", "level"),
    [
        (Autopilot.PX4, "COM_DL_LOSS_T", 5, Level.WARNING),
        (Autopilot.PX4, "NAV_DLL_ACT", 5, Level.BLOCKER),
        (Autopilot.PX4, "COM_LOW_BAT_ACT", 0, Level.WARNING),
        (Autopilot.PX4, "GF_ACTION", 0, Level.WARNING),
        (Autopilot.PX4, "GF_MAX_HOR_DIST", 30, Level.BLOCKER),
        (Autopilot.PX4, "GF_MAX_VER_DIST", 50, Level.BLOCKER),
        (Autopilot.ARDUPILOT, "SYSID_MYGCS", 255, Level.WARNING),
        (Autopilot.ARDUPILOT, "FS_GCS_ENABLE", 0, Level.WARNING),
        (Autopilot.ARDUPILOT, "FS_GCS_TIMEOUT", 3, Level.WARNING),
        (Autopilot.ARDUPILOT, "FS_OPTIONS", 16, Level.WARNING),
        (Autopilot.ARDUPILOT, "MIS_RESTART", 1, Level.BLOCKER),
        (Autopilot.ARDUPILOT, "BATT_FS_LOW_ACT", 0, Level.WARNING),
        (Autopilot.ARDUPILOT, "FENCE_RADIUS", 30, Level.BLOCKER),
        (Autopilot.ARDUPILOT, "FENCE_ALT_MAX", 50, Level.BLOCKER),
    ],
)
def test_each_parameter_is_named_with_what_to_set(autopilot: Autopilot, name: str, value: float, level: Level) -> None:
    (finding,) = audit(with_parameter(autopilot, name, value), NEEDS)
    assert (finding.name, finding.level) == (name, level)
    assert finding.should
    assert finding.why


def test_stream_rules_only_count_for_streams() -> None:
    alone = with_parameter(Autopilot.PX4, "COM_OBL_RC_ACT", 0)
    assert audit(alone, NEEDS) == []
    (late,) = audit(with_parameter(Autopilot.ARDUPILOT, "GUID_TIMEOUT", 5), replace(NEEDS, stream=True))
    assert late.name == "GUID_TIMEOUT"


@pytest.mark.parametrize(
    ("changes", "name", "level"),
    [
        ({"gps_fix": 2}, "GPS fix", Level.BLOCKER),
        ({"gps_fix": None}, "GPS fix", Level.BLOCKER),
        ({"satellites": 6}, "GPS satellites", Level.WARNING),
        ({"home_m": None}, "home position", Level.BLOCKER),
        ({"battery": 0.2}, "battery", Level.BLOCKER),
        ({"battery": 0.5}, "battery", Level.WARNING),
        ({"battery": None}, "battery", Level.WARNING),
        ({"battery": None, "battery_told": False}, "battery", Level.WARNING),
        ({"at_m": None}, "position", Level.BLOCKER),
        ({"parameters": {}}, "parameters", Level.WARNING),
        ({"mav_type": 1}, "vehicle type", Level.BLOCKER),
        ({"at_m": (10.0, 0.0)}, "place", Level.WARNING),
        ({"at_m": (30.0, 0.0)}, "place", Level.BLOCKER),
    ],
)
def test_measurements_count_too(changes: dict[str, Any], name: str, level: Level) -> None:
    (finding,) = audit(facts(Autopilot.PX4, **changes), NEEDS)
    assert (finding.name, finding.level) == (name, level)


@pytest.mark.parametrize("value", [0, 1, 2, 3, 4, 6, 7])
def test_a_px4_that_does_not_hold_without_setpoints_is_streamed_to_only_by_force(value: int) -> None:
    vehicle = with_parameter(Autopilot.PX4, "COM_OBL_RC_ACT", value)
    (refused,) = audit(vehicle, replace(NEEDS, stream=True))
    assert (refused.name, refused.level, refused.should) == ("COM_OBL_RC_ACT", Level.BLOCKER, "5 (hold)")
    assert refused.refuses
    (forced,) = audit(vehicle, replace(NEEDS, stream=True, force_stream=True))
    assert (forced.level, forced.refuses) == (Level.WARNING, False)


def test_a_px4_that_would_miss_waypoints_on_climbs_flies_no_mission_over_hills() -> None:
    climbs = replace(NEEDS, climb_m=7.5)
    stock = with_parameter(Autopilot.PX4, "NAV_MC_ALT_RAD", 0.8)
    assert audit(stock, NEEDS) == []
    (refused,) = audit(stock, climbs)
    assert (refused.name, refused.level, refused.refuses) == ("NAV_MC_ALT_RAD", Level.BLOCKER, True)
    assert refused.should == "at least 7.5, what the plan climbs in a slot"
    (streamed,) = audit(stock, replace(climbs, stream=True))
    assert (streamed.level, streamed.refuses) == (Level.WARNING, False)
    assert audit(with_parameter(Autopilot.PX4, "NAV_MC_ALT_RAD", 7.5), climbs) == []


@pytest.mark.parametrize(
    ("autopilot", "name", "value"),
    [
        (Autopilot.PX4, "MPC_Z_V_AUTO_UP", 1.4),
        (Autopilot.PX4, "MPC_Z_V_AUTO_DN", 1.4),
        (Autopilot.ARDUPILOT, "WPNAV_SPEED_UP", 140.0),
        (Autopilot.ARDUPILOT, "WPNAV_SPEED_DN", 140.0),
    ],
)
def test_a_vehicle_that_climbs_more_slowly_than_planned_is_reported(
    autopilot: Autopilot, name: str, value: float
) -> None:
    slow = with_parameter(autopilot, name, value)
    assert audit(slow, NEEDS) == []
    assert [one.name for one in audit(slow, replace(NEEDS, climb_m=7.5))] == [name]
    assert audit(with_parameter(autopilot, name, value * 1.5 / 1.4), replace(NEEDS, climb_m=7.5)) == []


def test_a_start_too_far_off_is_refused_in_any_case_and_how_far_is_a_setting() -> None:
    for at_m, within_m, refuses in ((14.0, 15.0, False), (16.0, 15.0, True), (4.0, 3.0, True), (50.0, 60.0, False)):
        (place,) = audit(facts(Autopilot.PX4, at_m=(0.0, at_m)), replace(NEEDS, start_within_m=within_m))
        assert (place.name, place.refuses, place.level is Level.BLOCKER) == ("place", refuses, refuses)


def test_a_first_leg_that_ends_more_than_eight_metres_behind_is_reported_with_the_metres() -> None:
    long_legs = replace(NEEDS, path_m=[(0.0, 0.0), (40.0, 0.0), (40.0, 40.0), (80.0, 40.0)])
    found = {one.name: one for one in audit(facts(Autopilot.ARDUPILOT, model=ARDUCOPTER), long_legs)}
    late = found["speed not reachable"]
    assert late.level is Level.WARNING
    assert late.found.startswith("12.1 m behind when slot 1 begins")
    nimble = audit(facts(Autopilot.ARDUPILOT), long_legs)
    assert "speed not reachable" not in {one.name for one in nimble}
    (late,) = audit(facts(Autopilot.PX4, model=PX4), long_legs)
    assert (late.name, late.level) == ("speed not reachable", Level.WARNING)
    assert late.found.startswith("11.7 m behind when slot 1 begins")
    shorter_legs = replace(NEEDS, path_m=[(0.0, 0.0), (30.0, 0.0), (30.0, 30.0)])
    assert audit(facts(Autopilot.PX4, model=PX4), shorter_legs) == []


def test_only_multirotors_fly_and_a_blocker_about_that_is_never_only_reported() -> None:
    for mav_type in range(44):
        blocked = [one for one in audit(facts(Autopilot.ARDUPILOT, mav_type=mav_type), NEEDS) if one.refuses]
        assert bool(blocked) is (mav_type not in {2, 3, 13, 14, 15, 29, 35}), mav_type
    assert not any(one.refuses for one in audit(facts(Autopilot.PX4, gps_fix=0, home_m=None), NEEDS))


def test_each_fact_that_was_never_told_is_a_finding_of_its_own() -> None:
    nothing = facts(Autopilot.PX4, gps_fix=None, at_m=None, home_m=None, battery=None, battery_told=False)
    assert [finding.name for finding in audit(nothing, NEEDS)] == ["GPS fix", "home position", "position", "battery"]


def test_a_mission_that_does_not_fit_is_a_blocker() -> None:
    (finding,) = audit(facts(Autopilot.PX4), replace(NEEDS, items=201))
    assert (finding.name, finding.found) == ("mission", "201 items")


def test_a_speed_the_vehicle_does_not_reach_inside_a_slot_is_reported() -> None:
    slow = replace(PX4, max_speed_mps=4.0)
    (too_fast,) = audit(facts(Autopilot.PX4, model=slow), NEEDS)
    assert (too_fast.level, too_fast.name) == (Level.BLOCKER, "max_speed_mps")
    lazy = replace(PX4, acceleration_mps2=0.8)
    (never,) = audit(facts(Autopilot.PX4, model=lazy), NEEDS)
    assert (never.level, never.found) == (Level.BLOCKER, "5 m/s takes 6.2 s to reach")
    (late,) = audit(facts(Autopilot.ARDUPILOT, model=ARDUCOPTER), NEEDS)
    assert late.level is Level.WARNING
    assert late.should.endswith("WPNAV_JERK (WP_JERK) of at least 3.2")


def test_blockers_come_first() -> None:
    findings = audit(facts(Autopilot.PX4, satellites=5, home_m=None), NEEDS)
    assert [finding.level for finding in findings] == [Level.BLOCKER, Level.WARNING]


@pytest.mark.parametrize("autopilot", list(Autopilot))
@pytest.mark.parametrize("loss", [0.0, 0.3])
def test_parameters_are_read_by_name_over_a_bad_link_and_unknown_ones_left_out(
    autopilot: Autopilot, loss: float
) -> None:
    chance = random.Random(4)
    vehicle = SimAutopilot(
        VehicleSpec(1, 47.0, 8.0, autopilot=autopilot.value), protocol_clock=lambda: 0.0, on_event=lambda *_: None
    )
    reading = ParameterRead([*profile_of(autopilot).parameter_names(), "NO_SUCH"], 1, autopilot)
    now_s, messages = 0.0, reading.start(0.0)
    while not reading.ended:
        for message in messages:
            if chance.random() >= loss:
                for answer in vehicle.handle(incoming(message)):
                    reading.handle(answer.get_type(), fields_of(answer), now_s)
        now_s += 0.1
        messages = reading.tick(now_s)
    if loss == 0.0:
        known = "COM_DL_LOSS_T" if autopilot is Autopilot.PX4 else "FS_GCS_TIMEOUT"
        assert reading.values[known] == vehicle.parameters[known]
    assert "NO_SUCH" not in reading.values
    assert len(reading.values) > 5
    assert model_from_parameters(autopilot, reading.values).acceleration_mps2 > 1.0


def test_px4_sends_integers_bytewise() -> None:
    def wire(value: int) -> float:
        return float(struct.unpack("<f", struct.pack("<i", value))[0])

    assert parameter_value({"param_value": wire(10), "param_type": 6}, Autopilot.PX4) == 10
    assert parameter_value({"param_value": None, "param_type": 6}, Autopilot.PX4) == -1  # NaN in JSON
    assert parameter_value({"param_value": 10.0, "param_type": 6}, Autopilot.ARDUPILOT) == 10
    assert parameter_value({"param_value": 0.5, "param_type": 9}, Autopilot.PX4) == 0.5


def test_old_and_new_names_of_arducopter_mean_the_same() -> None:
    old = model_from_parameters(
        Autopilot.ARDUPILOT, {"WPNAV_ACCEL": 250.0, "WPNAV_SPEED": 1000.0, "WPNAV_RADIUS": 200.0, "WPNAV_JERK": 1.0}
    )
    new = model_from_parameters(
        Autopilot.ARDUPILOT, {"WP_ACC": 2.5, "WP_SPD": 10.0, "WP_RADIUS_M": 2.0, "WP_JERK": 1.0}
    )
    assert old == new
    assert model_from_parameters(Autopilot.ARDUPILOT, {}) == ARDUCOPTER
    assert model_from_parameters(Autopilot.PX4, {}) == PX4


def test_a_parameter_that_makes_no_sense_is_refused_by_name() -> None:
    with pytest.raises(ValueError, match="max_speed_mps"):
        model_from_parameters(Autopilot.PX4, {"MPC_XY_VEL_MAX": 0.0})


def test_a_battery_that_does_not_cover_the_plan_keeps_it_on_the_ground() -> None:
    needs = replace(NEEDS, battery_for_plan=0.85)
    (finding,) = audit(facts(Autopilot.PX4, battery=0.84), needs)
    assert (finding.name, finding.level, finding.refuses) == ("battery for the plan", Level.BLOCKER, True)
    assert (finding.found, finding.should) == ("84%", "at least 85%")
    assert audit(facts(Autopilot.PX4, battery=0.86), needs) == []
