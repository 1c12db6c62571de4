from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from math import isnan
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink import mavwp

from skyfolio.mavlink_bridge import (
    Autopilot,
    FormatError,
    Mission,
    MissionItem,
    OnEnd,
    compile_mission,
    from_qgc_plan,
    from_waypoints,
    geodetic_to_east_north,
    mission_differences,
    to_qgc_plan,
    to_waypoints,
)
from skyfolio.mavlink_bridge.fence import fence_items, rally_items
from skyfolio.mavlink_bridge.items import Command
from skyfolio.mavlink_bridge.plan_extras import fence_from_qgc_plan, fence_to_json, rally_from_qgc_plan
from skyfolio.planner.plans import Plan

places = st.builds(
    MissionItem,
    seq=st.just(0),
    frame=st.just(6),
    command=st.sampled_from([16, 17, 21, 22]),
    current=st.just(1),
    param1=st.integers(0, 3_600_000).map(lambda ms: ms / 1000),
    x=st.integers(-900_000_000, 900_000_000),
    y=st.integers(-1_800_000_000, 1_800_000_000),
    z=st.integers(0, 2_000_000).map(lambda cm: cm / 100),
)


@given(item=places)
def test_plan_files_keep_every_item_exactly(item: MissionItem) -> None:
    mission = Mission(uav_id="u", items=(item,), slot_of_item={0: 0}, duration_s=1.0)
    assert from_qgc_plan(json.loads(json.dumps(to_qgc_plan(mission)))) == mission.items


@given(item=places)
def test_waypoint_files_keep_every_item_exactly(item: MissionItem) -> None:
    mission = Mission(uav_id="u", items=(item,), slot_of_item={0: 0}, duration_s=1.0)
    assert from_waypoints(to_waypoints(mission)) == mission.items


@pytest.mark.parametrize("on_end", list(OnEnd))
@pytest.mark.parametrize("autopilot", list(Autopilot))
def test_a_compiled_mission_survives_both_formats(line_and_hover: Plan, on_end: OnEnd, autopilot: Autopilot) -> None:
    mission = compile_mission(line_and_hover, "uav-1", on_end=on_end, autopilot=autopilot)
    assert from_qgc_plan(json.loads(json.dumps(to_qgc_plan(mission), allow_nan=False))) == mission.items
    assert mission_differences(mission.items, from_waypoints(to_waypoints(mission))) == ()


def test_geofence_and_rally_points_survive_a_plan_file(line_and_hover: Plan) -> None:
    scenario = line_and_hover.scenario.with_changes(area_m=((-20.0, -20.0), (80.0, 80.0)))
    fence, rally = fence_items(scenario), rally_items(scenario, [(0.0, 0.0), (33.3, 4.4)], 25.0)
    plan = to_qgc_plan(compile_mission(line_and_hover, "uav-1"), fence=fence, rally=rally)
    read = json.loads(json.dumps(plan))
    assert fence_from_qgc_plan(read) == fence
    assert rally_from_qgc_plan(read) == rally
    corners = [geodetic_to_east_north(scenario.origin, item.x / 1e7, item.y / 1e7) for item in fence]
    assert corners == [pytest.approx(corner, abs=0.02) for corner in [(-40, -40), (100, -40), (100, 100), (-40, 100)]]


def test_pymavlink_reads_the_waypoints_file_to_1e7_degrees(line_and_hover: Plan, tmp_path: Path) -> None:
    mission = compile_mission(line_and_hover, "uav-1")
    file = tmp_path / "uav-1.waypoints"
    file.write_text(to_waypoints(mission), encoding="utf-8")
    loader = mavwp.MAVWPLoader()
    assert loader.load(str(file)) == len(mission.items)
    for item, read in zip(mission.items, loader.wpoints, strict=True):
        assert (read.seq, read.command, read.current, read.autocontinue) == (
            item.seq,
            item.command,
            item.current,
            item.autocontinue,
        )
        assert (round(read.x * 1e7), round(read.y * 1e7)) == (item.x, item.y)
        assert (read.param1, read.param2, read.z) == pytest.approx((item.param1, item.param2, item.z))


def test_a_plan_file_has_the_parts_qgroundcontrol_insists_on(line_and_hover: Plan) -> None:
    plan = to_qgc_plan(compile_mission(line_and_hover, "uav-1"), home_alt_m=488.0)
    assert {"fileType", "version", "groundStation", "mission", "geoFence", "rallyPoints"} == set(plan)
    assert plan["mission"]["plannedHomePosition"] == pytest.approx([47.397742, 8.545594, 488.0], abs=1e-7)
    assert {item["frame"] for item in plan["mission"]["items"]} == {2, 3}
    assert [item["doJumpId"] for item in plan["mission"]["items"]] == list(range(1, 12))


def mutated(change: Callable[[dict[str, object]], object]) -> dict[str, object]:
    item = MissionItem(seq=0, frame=6, command=16, current=1, x=1, y=1, z=1.0)
    plan = to_qgc_plan(Mission(uav_id="u", items=(item,), slot_of_item={0: 0}, duration_s=1.0))
    change(plan["mission"]["items"][0])
    return plan


@pytest.mark.parametrize(
    ("plan", "rule"),
    [
        ({}, "KeyError"),
        ({"fileType": "Fence"}, "must be 'Plan'"),
        (mutated(lambda item: item.update(type="ComplexItem")), "items.0.type"),
        (mutated(lambda item: item.update(params=[1.0])), "must be 7"),
        (mutated(lambda item: item.update(params=[0, 0, 0, 0, 91.0, 0, 0])), "latitude"),
        (mutated(lambda item: item.update(params=[0, 0, 0, 0, float("nan"), 0, 0])), "finite"),
        (mutated(lambda item: item.update(params=3)), "TypeError"),
    ],
)
def test_what_is_not_a_plan_is_refused_with_the_rule(plan: dict[str, object], rule: str) -> None:
    with pytest.raises(FormatError, match=rule):
        from_qgc_plan(plan)


@pytest.mark.parametrize(
    ("text", "rule"),
    [
        ("", "line 1"),
        ("QGC WPL 100\n", "line 1"),
        ("QGC WPL 110\n0 1 3\n", "line 2: 3 columns, must be 12"),
        ("QGC WPL 110\n0 1 3 16 0 0 0 0 x 8 60 1\n", "line 2: could not convert"),
        ("QGC WPL 110\n\n4 1 3 16 0 0 0 0 47 8 60 1\n", "line 3: item 4, must be 0"),
    ],
)
def test_what_is_not_a_waypoints_file_is_refused_with_the_line(text: str, rule: str) -> None:
    with pytest.raises(FormatError, match=rule):
        from_waypoints(text)


def test_a_null_parameter_is_nan_and_survives_both_formats() -> None:
    plan = mutated(lambda item: item.update(params=[0.0, 0.0, 0.0, None, 47.0, 8.0, 60.0]))
    (item,) = from_qgc_plan(plan)
    assert isnan(item.param4)  # the heading is as the vehicle has it, not north
    assert (item.param1, item.x, item.y, item.z) == (0.0, 470000000, 80000000, 60.0)
    mission = Mission(uav_id="u", items=(item,), slot_of_item={0: 0}, duration_s=1.0)
    written = json.dumps(to_qgc_plan(mission), allow_nan=False)
    for read in (from_qgc_plan(json.loads(written)), from_waypoints(to_waypoints(mission))):
        assert isnan(read[0].param4)
        assert replace(read[0], param4=0.0) == replace(item, param4=0.0)


def test_a_take_off_without_a_place_is_where_the_vehicle_is() -> None:
    plan = mutated(lambda item: item.update(command=22, params=[0, 0, 0, None, None, None, 30]))
    (item,) = from_qgc_plan(plan)
    assert (item.x, item.y, item.z) == (0, 0, 30.0)


def test_an_item_with_a_place_and_no_altitude_is_refused() -> None:
    with pytest.raises(FormatError, match=r"items\.0\.params\.6: null"):
        from_qgc_plan(mutated(lambda item: item.update(params=[0, 0, 0, 0, 47.0, 8.0, None])))


ROWS = (
    "0\t1\t0\t16\t0\t0\t0\t0\t-33.9\t151.2\t21.5\t1",
    "1\t0\t3\t16\t2\t0\t0\t0\t-33.9001\t151.2001\t30\t1",
)


@pytest.mark.parametrize(
    "text",
    [
        "\n".join(["QGC WPL 110", "# home", ROWS[0], "  # a waypoint", ROWS[1]]),
        "\n".join(["\ufeffQGC WPL 110", *ROWS]),
        "\n".join(["QGC WPL 110", "1" + ROWS[0][1:], "2" + ROWS[1][1:]]),
    ],
    ids=["comments", "byte order mark", "rows from 1"],
)
def test_waypoint_files_of_other_tools_are_read(text: str) -> None:
    items = from_waypoints(text)
    assert [item.seq for item in items] == [0, 1]
    assert [item.x for item in items] == [-339000000, -339001000]


FENCE = {
    "version": 2,
    "circles": [{"version": 1, "inclusion": False, "circle": {"center": [-33.905, 151.204], "radius": 30}}],
    "polygons": [
        {"version": 1, "inclusion": True, "polygon": [[-33.9, 151.2], [-33.9, 151.21], [-33.91, 151.21]]},
        {"version": 1, "inclusion": False, "polygon": [[-33.905, 151.205], [-33.905, 151.206], [-33.906, 151.206]]},
    ],
}


def test_a_fence_keeps_every_polygon_and_circle() -> None:
    items = fence_from_qgc_plan({"geoFence": FENCE})
    assert [int(item.command) for item in items] == [5001] * 3 + [5002] * 3 + [5004]
    assert [item.seq for item in items] == list(range(7))
    assert (items[-1].param1, items[-1].x, items[-1].y) == (30.0, -339050000, 1512040000)
    assert fence_to_json(items) == FENCE


@pytest.mark.parametrize(
    ("fence", "rule"),
    [
        ({"polygons": [{"inclusion": True, "polygon": [[0, 0], [1, 1]]}]}, "polygons.0.polygon: 2 vertices"),
        ({"polygons": [{"inclusion": "yes", "polygon": [[0, 0], [1, 1], [0, 1]]}]}, "polygons.0.inclusion"),
        ({"circles": [{"inclusion": True, "circle": {"center": [0, 0], "radius": 0}}]}, "circles.0.circle.radius"),
        ({"circles": [{"inclusion": True, "circle": {"center": [91, 0], "radius": 5}}]}, "circles.0.circle.center"),
        ({"polygons": [], "breachReturn": [47.0, 8.0, 30.0]}, "breachReturn"),
        ({"circles": [{}]}, "KeyError"),
    ],
)
def test_a_fence_that_cannot_be_taken_whole_is_refused_by_name(fence: dict[str, object], rule: str) -> None:
    with pytest.raises(FormatError, match=rule):
        fence_from_qgc_plan({"geoFence": fence})


def test_items_that_are_no_fence_are_not_written_as_one() -> None:
    vertex = MissionItem(seq=0, frame=0, command=Command.NAV_FENCE_POLYGON_VERTEX_INCLUSION, param1=3.0)
    with pytest.raises(FormatError, match="of which not all follow"):
        fence_to_json([vertex, replace(vertex, seq=1)])
    with pytest.raises(FormatError, match=r"fence\.0\.command: 16"):
        fence_to_json([replace(vertex, command=16)])
