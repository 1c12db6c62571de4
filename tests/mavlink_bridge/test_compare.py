from __future__ import annotations

import struct
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skyfolio.mavlink_bridge import Frame, MissionItem, mission_differences

WAYPOINT = MissionItem(seq=0, frame=6, command=16, current=1, param1=12.3, param2=1.0, x=473977420, y=85455940, z=60.1)
SPEED = MissionItem(seq=1, frame=Frame.MISSION, command=178, param1=1.0, param2=4.753, param3=-1.0)


def as_float32(value: float) -> float:
    return float(struct.unpack("<f", struct.pack("<f", value))[0])


@given(hold=st.floats(0, 3600), altitude=st.floats(0.1, 20_000))
def test_float32_rounding_is_no_difference(hold: float, altitude: float) -> None:
    sent = replace(WAYPOINT, param1=hold, z=altitude)
    assert mission_differences([sent], [replace(sent, param1=as_float32(hold), z=as_float32(altitude))]) == ()


@pytest.mark.parametrize("change", [{"x": 473977421}, {"y": 85455939}, {"command": 21}, {"frame": 0}, {"seq": 5}])
def test_integers_must_be_exact(change: dict[str, Any]) -> None:
    (text,) = mission_differences([WAYPOINT], [replace(WAYPOINT, **change)])
    assert next(iter(change)) in text


@pytest.mark.parametrize("change", [{"param1": 12.0}, {"param2": 1.001}, {"param4": 90.0}, {"z": 60.0}])
def test_a_changed_parameter_is_named_with_both_values(change: dict[str, Any]) -> None:
    (text,) = mission_differences([WAYPOINT], [replace(WAYPOINT, **change)])
    (name,) = change
    assert text == f"item 0: {name} {getattr(WAYPOINT, name)} sent, {change[name]} read back"


def test_the_current_flag_is_the_vehicles_own() -> None:
    assert mission_differences([WAYPOINT], [replace(WAYPOINT, current=0)]) == ()


def test_where_an_item_without_position_is_does_not_matter() -> None:
    assert mission_differences([SPEED], [replace(SPEED, frame=0, x=1, y=2, z=3.0)]) == ()


def test_a_missing_item_is_told_by_the_numbers() -> None:
    assert mission_differences([WAYPOINT, SPEED], [WAYPOINT]) == ("2 items sent, 1 read back",)
