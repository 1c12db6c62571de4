"""sim.parameter_store"""

import math
import struct
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest

from skyfolio.sim.flavours import FLAVOURS, PX4
from skyfolio.sim.kinematics import Limits
from skyfolio.sim.parameter_store import INT32, REAL32, ParameterStore

if TYPE_CHECKING:
    from tests.sim.conftest import Bench


def by_name(bench: "Bench", name: str) -> Any:
    (value,) = bench.ask("param_request_read", 1, 1, name.encode(), -1)
    return value


def test_the_list_holds_every_parameter_once_with_its_index(bench: "Bench") -> None:
    values = bench.ask("param_request_list", 1, 1)
    assert [value.param_index for value in values] == list(range(len(values)))
    assert {value.param_count for value in values} == {len(values)}
    assert len({value.param_id for value in values}) == len(values)


def test_a_parameter_can_be_set_and_takes_effect(bench: "Bench") -> None:
    (value,) = bench.ask("param_set", 1, 1, b"MPC_XY_VEL_MAX", 7.5, REAL32)
    assert value.param_value == 7.5
    assert bench.autopilot.parameters.limits.max_speed_mps == 7.5


def test_a_parameter_is_found_by_index_and_by_name(bench: "Bench") -> None:
    value = by_name(bench, "NAV_ACC_RAD")
    (same,) = bench.ask("param_request_read", 1, 1, b"", value.param_index)
    assert same.param_id in ("NAV_ACC_RAD", b"NAV_ACC_RAD")
    assert bench.ask("param_request_read", 1, 1, b"", 999) == []


def test_integers_travel_bytewise_inside_the_float(bench: "Bench") -> None:
    value = by_name(bench, "MAV_TYPE")
    assert value.param_type == INT32
    assert struct.unpack("<i", struct.pack("<f", value.param_value)) == (2,)
    on_the_wire = struct.unpack("<f", struct.pack("<i", 13))[0]
    bench.ask("param_set", 1, 1, b"MAV_TYPE", on_the_wire, INT32)
    assert bench.autopilot.parameters["MAV_TYPE"] == 13


@pytest.mark.parametrize("value", [-1.0, 1e9, math.nan, math.inf])
def test_a_value_out_of_range_changes_nothing_and_is_answered_with_the_old_one(bench: "Bench", value: float) -> None:
    (answer,) = bench.ask("param_set", 1, 1, b"NAV_ACC_RAD", value, REAL32)
    assert answer.param_value == bench.autopilot.parameters["NAV_ACC_RAD"] == 2.0


def test_an_unknown_name_or_a_wrong_type_is_answered_by_a_text(bench: "Bench") -> None:
    for message in (("param_set", 1, 1, b"NONSENSE", 1.0, REAL32), ("param_set", 1, 1, b"NAV_ACC_RAD", 1.0, INT32)):
        (words,) = bench.ask(*message)
        assert words.get_type() == "STATUSTEXT"
    (words,) = bench.ask("param_request_read", 1, 1, b"NONSENSE", -1)
    assert words.get_type() == "STATUSTEXT"


def store_of(flavour: str, limits: Limits) -> ParameterStore:
    known = FLAVOURS[flavour]
    return ParameterStore(known.parameters(limits), known.tuning, bytewise=known.bytewise)


def test_the_store_boots_with_the_limits_it_was_given() -> None:
    limits = Limits(max_speed_mps=9.0, acceleration_mps2=2.0, climb_mps=2.5)
    assert store_of("px4", limits).limits == limits
    slow = Limits(max_speed_mps=20.0, cruise_speed_mps=4.0, climb_acceleration_mps2=2.0, descend_acceleration_mps2=2.0)
    assert store_of("ardupilot", replace(slow, jerk_mps3=2.0)).limits == replace(slow, jerk_mps3=2.0)


def test_setting_from_python_checks_name_and_range() -> None:
    store = store_of("px4", PX4.limits)
    with pytest.raises(KeyError):
        store["NONSENSE"] = 1.0
    with pytest.raises(ValueError, match="MIS_TAKEOFF_ALT must be between"):
        store["MIS_TAKEOFF_ALT"] = -5.0


def test_ardupilot_sends_integers_as_numbers_and_does_not_answer_for_unknown_names(copter: "Bench") -> None:
    value = by_name(copter, "RTL_ALT")
    assert (value.param_value, value.param_type) == (1500.0, INT32)
    (answer,) = copter.ask("param_set", 1, 1, b"RTL_ALT", 2500.0, REAL32)
    assert answer.param_value == 2500.0
    assert copter.autopilot.parameters.tuning.return_alt_m == 25.0
    assert copter.ask("param_set", 1, 1, b"NONSENSE", 1.0, REAL32) == []
    assert copter.ask("param_request_read", 1, 1, b"NONSENSE", -1) == []


def test_ardupilot_takes_any_finite_number_and_is_careful_only_where_it_uses_it(copter: "Bench") -> None:
    (answer,) = copter.ask("param_set", 1, 1, b"WPNAV_SPEED", -5.0, REAL32)
    assert answer.param_value == -5.0
    assert copter.autopilot.parameters.limits.cruise_speed_mps == 0.2
    (answer,) = copter.ask("param_set", 1, 1, b"WPNAV_SPEED", math.nan, REAL32)
    assert answer.param_value == -5.0
