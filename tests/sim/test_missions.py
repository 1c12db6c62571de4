"""sim.missions"""

import math
from dataclasses import replace

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.sim.missions import NOT_GIVEN, Mission, MissionItem, rejection

WAYPOINT = MissionItem(0, 6, 16, 0, 1, 0.0, 0.0, 0.0, math.nan, 473977420, 85455940, 20.0)
SPEED = replace(WAYPOINT, command=178, frame=2, param1=1.0, param2=5.0, x=0, y=0, z=0.0)


@pytest.mark.parametrize(
    "item",
    [
        WAYPOINT,
        SPEED,
        replace(SPEED, param2=-1.0),
        replace(WAYPOINT, command=20, frame=2),
        replace(WAYPOINT, command=21, x=0, y=0, z=0.0),
        replace(WAYPOINT, command=22, x=NOT_GIVEN, y=NOT_GIVEN),
        replace(WAYPOINT, frame=0, z=508.0),
    ],
)
def test_what_can_be_flown_is_accepted(item: MissionItem) -> None:
    assert rejection(item) is None


@pytest.mark.parametrize(
    ("item", "result"),
    [
        (replace(WAYPOINT, command=82), "UNSUPPORTED"),
        (replace(WAYPOINT, frame=1), "UNSUPPORTED_FRAME"),
        (replace(WAYPOINT, frame=2), "UNSUPPORTED_FRAME"),
        (replace(WAYPOINT, param1=-1.0), "INVALID_PARAM1"),
        (replace(WAYPOINT, param1=math.nan), "INVALID_PARAM1"),
        (replace(WAYPOINT, param2=math.inf), "INVALID_PARAM2"),
        (replace(SPEED, param2=0.0), "INVALID_PARAM2"),
        (replace(SPEED, param2=math.nan), "INVALID_PARAM2"),
        (replace(WAYPOINT, x=NOT_GIVEN), "INVALID_PARAM5_X"),
        (replace(WAYPOINT, x=910_000_000), "INVALID_PARAM5_X"),
        (replace(WAYPOINT, y=-1_810_000_000), "INVALID_PARAM6_Y"),
        (replace(WAYPOINT, z=math.nan), "INVALID_PARAM7"),
    ],
)
def test_what_cannot_be_flown_is_refused_with_the_field_at_fault(item: MissionItem, result: str) -> None:
    assert rejection(item) == getattr(dialect, f"MAV_MISSION_{result}")


def test_the_mission_id_changes_with_the_plan_but_not_with_the_cursor() -> None:
    plan = Mission((WAYPOINT, SPEED))
    assert plan.mission_id == Mission((replace(WAYPOINT, current=1), SPEED)).mission_id
    assert plan.mission_id != Mission((replace(WAYPOINT, z=21.0), SPEED)).mission_id
    assert Mission().mission_id == 0


def test_an_altitude_above_sea_level_becomes_one_above_home() -> None:
    assert replace(WAYPOINT, frame=5, z=508.0).relative_alt_m(488.0) == 20.0
    assert WAYPOINT.relative_alt_m(488.0) == 20.0
