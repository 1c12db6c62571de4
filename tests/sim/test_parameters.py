"""sim.parameters"""

import math
import struct
from typing import TYPE_CHECKING, Any

import pytest

from sim.parameters import INT32, REAL32, ParameterStore, parameters_of
from sim.vehicle import Limits

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


def test_an_unknown_name_or_a_wrong_type_is_answered_in_words(bench: "Bench") -> None:
    for message in (("param_set", 1, 1, b"NONSENSE", 1.0, REAL32), ("param_set", 1, 1, b"NAV_ACC_RAD", 1.0, INT32)):
        (words,) = bench.ask(*message)
        assert words.get_type() == "STATUSTEXT"
    (words,) = bench.ask("param_request_read", 1, 1, b"NONSENSE", -1)
    assert words.get_type() == "STATUSTEXT"


def test_the_store_boots_with_the_limits_it_was_given() -> None:
    limits = Limits(max_speed_mps=9.0, acceleration_mps2=2.0, climb_mps=2.5)
    assert ParameterStore(limits).limits == limits
    assert [parameter.name for parameter in parameters_of(limits)] == sorted(p.name for p in parameters_of(limits))


def test_setting_from_python_checks_name_and_range() -> None:
    store = ParameterStore(Limits())
    with pytest.raises(KeyError):
        store["NONSENSE"] = 1.0
    with pytest.raises(ValueError, match="MIS_TAKEOFF_ALT must be between"):
        store["MIS_TAKEOFF_ALT"] = -5.0
