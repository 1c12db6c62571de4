"""What autopilots give back, row by row: (sent, read back) as their sources and recordings of them have it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import isnan, nan
from typing import Any

import pytest

from skyfolio.api.lab.virtual_wire import Wire, autopilot_on
from skyfolio.mavlink_bridge import Autopilot, Command, MissionItem, mission_differences
from skyfolio.mavlink_bridge.mission_messages import MissionType
from skyfolio.mavlink_bridge.profiles import PROFILES
from skyfolio.mavlink_bridge.verified import OnBoard, VerifiedUpload

COPTER, PX4 = Autopilot.ARDUPILOT, Autopilot.PX4
MISSION, FENCE, RALLY = MissionType.MISSION, MissionType.FENCE, MissionType.RALLY
PLACE = {"x": 473977420, "y": 85455940}
Fields = dict[str, Any]


def item(command: int, **fields: Any) -> MissionItem:
    """Item 1 of a list, somewhere."""
    return MissionItem(**{"seq": 1, "frame": 6, "command": command, **PLACE, "z": 60.0, **fields})


def differences(autopilot: Autopilot, kind: MissionType, sent: MissionItem, read: MissionItem) -> tuple[str, ...]:
    home = item(16, seq=0)
    return mission_differences([home, sent], [home, read], autopilot=autopilot, mission_type=kind)


NOWHERE = {"x": 0, "y": 0, "z": 0.0}
ORDER: Fields = {"frame": 2, **NOWHERE}
FLAT: Fields = {"z": 0.0}
ROWS: list[tuple[Autopilot, MissionType, int, Fields, Fields]] = [
    (COPTER, MISSION, 16, {"param1": 7.0, "param2": 2.0, "param4": 90.0}, {"param2": 0.0, "param4": 0.0, "frame": 3}),
    (COPTER, MISSION, 16, {"param1": 7.9}, {"param1": 7.0, "frame": 3}),
    (COPTER, MISSION, 16, {"z": 60.37}, {"z": 60.36, "frame": 3}),
    (COPTER, MISSION, 16, {"param4": nan, "autocontinue": 0}, {"param4": 0.0, "autocontinue": 1, "frame": 3}),
    (COPTER, MISSION, 82, {"param1": 3.2}, {"param1": 3.0, "frame": 3}),
    (COPTER, MISSION, 17, {"param3": -20.4, "param4": 9.0}, {"param3": -20.0, "param4": 0.0, "frame": 3}),
    (COPTER, MISSION, 19, {"param1": 9.5, "param3": 0.0}, {"param1": 9.0, "param3": 1.0, "frame": 3}),
    (COPTER, MISSION, 19, {"param3": -5.0, "param4": 1.0}, {"param3": -1.0, "param4": 1.0, "frame": 3}),
    (COPTER, MISSION, 20, {**ORDER, "param1": 1.0}, {"frame": 0, "param1": 0.0}),
    (COPTER, MISSION, 21, {"z": 0.0}, {"param4": 1.0, "frame": 3}),
    (COPTER, MISSION, 21, {"z": 0.0, "param4": -90.0}, {"param4": -1.0, "frame": 3}),
    (COPTER, MISSION, 22, {"param1": 15.0, "param4": 45.0}, {"param1": 15.0, "param4": 0.0, "frame": 3}),
    (COPTER, MISSION, 93, {**ORDER, "param1": -1.0, "param2": 12.0}, {"frame": 0}),
    (COPTER, MISSION, 178, {**ORDER, "param1": 1.0, "param2": 4.753, "param3": -1.0}, {"frame": 0}),
    (COPTER, MISSION, 178, {"frame": 3, "param1": 1.0, "param2": 4.5}, {"frame": 0, **NOWHERE}),
    (COPTER, FENCE, 5000, {**FLAT, "frame": 3}, {"frame": 0, "autocontinue": 0}),
    (COPTER, FENCE, 5001, {**FLAT, "frame": 0, "param1": 4.0}, {"autocontinue": 0}),
    (COPTER, FENCE, 5002, {"z": 30.0, "frame": 3, "param1": 5.0}, {"z": 0.0, "frame": 0, "autocontinue": 0}),
    (COPTER, FENCE, 5003, {**FLAT, "frame": 3, "param1": 80.0004}, {"param1": 80.0, "frame": 0, "autocontinue": 0}),
    (COPTER, FENCE, 5004, {**FLAT, "frame": 6, "param1": 12.75}, {"frame": 0, "autocontinue": 0}),
    (COPTER, RALLY, 5100, {"frame": 3, "z": 62.7, "param1": 1.0}, {"z": 62.0, "param1": 0.0, "autocontinue": 0}),
    (
        PX4,
        MISSION,
        16,
        {"param1": 7.5, "param2": 2.0, "param3": 1.0, "param4": -90.0},
        {"param3": 0.0, "param4": 270.0},
    ),
    (PX4, MISSION, 16, {"param4": 360.0, "frame": 3}, {"param4": 0.0}),
    (PX4, MISSION, 16, {"param4": nan}, {}),
    (PX4, MISSION, 17, {"param1": 1.0, "param3": 20.5}, {"param1": 0.0}),
    (PX4, MISSION, 19, {"param1": 9.5, "param2": 3.0, "param4": -1.0}, {"param2": 1.0, "param4": 0.0}),
    (PX4, MISSION, 20, ORDER, {}),
    (PX4, MISSION, 21, {"z": 0.0, "param2": 1.0}, {}),
    (PX4, MISSION, 22, {"param1": 15.0, "param4": 30.0}, {"param1": 0.0, "param4": 29.999998}),
    (PX4, MISSION, 93, {**ORDER, "param1": 3.25}, {}),
    (PX4, MISSION, 178, {**ORDER, "param1": 1.0, "param2": 4.753, "param3": -1.0}, {}),
    (PX4, FENCE, 5000, {**FLAT, "frame": 3, "param1": 1.0}, {"frame": 5, "param1": 0.0, "autocontinue": 0}),
    (PX4, FENCE, 5001, {**FLAT, "frame": 0, "param1": 4.0}, {"frame": 5, "autocontinue": 0}),
    (PX4, FENCE, 5002, {**FLAT, "frame": 3, "param1": 5.0}, {"frame": 5, "autocontinue": 0}),
    (PX4, FENCE, 5003, {**FLAT, "frame": 3, "param1": 80.25}, {"frame": 5, "autocontinue": 0}),
    (PX4, FENCE, 5004, {**FLAT, "frame": 6, "param1": 12.75}, {"frame": 5, "autocontinue": 0}),
    (PX4, RALLY, 5100, {"frame": 3, "z": 62.7}, {"frame": 6}),
]


@pytest.mark.parametrize(("autopilot", "kind", "command", "sent", "read"), ROWS)
def test_what_an_autopilot_gives_back_of_a_sound_item_is_no_difference(
    autopilot: Autopilot, kind: MissionType, command: int, sent: Fields, read: Fields
) -> None:
    one = item(command, **sent)
    assert differences(autopilot, kind, one, replace(one, **read)) == ()


@pytest.mark.parametrize(("autopilot", "kind", "command", "sent", "read"), ROWS)
def test_anything_else_is_a_difference(
    autopilot: Autopilot, kind: MissionType, command: int, sent: Fields, read: Fields
) -> None:
    one = item(command, **sent)
    sound = replace(one, **read)
    placed = not (one.frame == ORDER["frame"] or (autopilot is COPTER and command == Command.DO_CHANGE_SPEED))
    for field in ("command", "param1", "param2", "param3", "param4", *(("x", "y", "z") if placed else ())):
        value = getattr(sound, field)
        change: Fields = {field: 1.5 if isnan(value) else value + 2}
        spoilt = replace(sound, **change)
        (text,) = differences(autopilot, kind, one, spoilt)
        assert text.startswith(f"item 1: {field} ")
    (text,) = differences(autopilot, kind, one, replace(sound, autocontinue=1 - sound.autocontinue))
    assert text.startswith("item 1: autocontinue ")


def test_every_row_of_the_table_has_its_example() -> None:
    examples = {(autopilot, kind, command) for autopilot, kind, command, _, _ in ROWS}
    assert examples == {
        (autopilot, kind, int(command))
        for autopilot, profile in PROFILES.items()
        for kind, rows in profile.kept.items()
        for command in rows
    }


@pytest.mark.parametrize(
    ("autopilot", "kind", "command", "frame"),
    [(COPTER, MISSION, 16, 0), (PX4, MISSION, 16, 5), (COPTER, RALLY, 5100, 0), (PX4, RALLY, 5100, 5)],
)
def test_an_altitude_that_is_measured_from_somewhere_else_is_a_difference(
    autopilot: Autopilot, kind: MissionType, command: int, frame: int
) -> None:
    one = item(command, frame=6)
    read = replace(one, frame=frame, autocontinue=int(kind is not RALLY or autopilot is PX4))
    assert differences(autopilot, kind, one, read) == (f"item 1: frame 6 sent, {frame} read back",)


def test_a_command_that_is_not_in_the_table_has_to_come_back_literally() -> None:
    one = item(300, param3=2.5)
    assert differences(COPTER, MISSION, one, replace(one, frame=3)) == ()
    assert differences(COPTER, MISSION, one, replace(one, param3=2.0)) == ("item 1: param3 2.5 sent, 2.0 read back",)


def test_only_a_copters_mission_begins_with_its_home() -> None:
    home, other = item(16, seq=0), item(16, seq=0, x=1)
    assert mission_differences([home], [other], autopilot=COPTER) == ()
    assert mission_differences([home], [other], autopilot=PX4) != ()
    corner = item(5001, seq=0, z=0.0, param1=3.0, autocontinue=0)
    assert mission_differences([corner], [replace(corner, x=1)], autopilot=COPTER, mission_type=FENCE) != ()


def fence(frame: int) -> list[MissionItem]:
    """A polygon to stay in, one to stay out of, and a circle of each kind."""
    corners = [(0, 0), (0, 90_000), (90_000, 90_000), (90_000, 0)]
    made = [
        item(command, frame=frame, z=0.0, param1=4.0, x=PLACE["x"] + north, y=PLACE["y"] + east)
        for command in (Command.NAV_FENCE_POLYGON_VERTEX_INCLUSION, Command.NAV_FENCE_POLYGON_VERTEX_EXCLUSION)
        for north, east in corners
    ]
    made.append(item(Command.NAV_FENCE_CIRCLE_INCLUSION, frame=frame, z=0.0, param1=250.5))
    made.append(item(Command.NAV_FENCE_CIRCLE_EXCLUSION, frame=frame, z=0.0, param1=12.0))
    return [replace(one, seq=seq) for seq, one in enumerate(made)]


@pytest.mark.parametrize("autopilot", list(Autopilot))
@pytest.mark.parametrize("frame", [0, 3, 6])
@pytest.mark.parametrize(
    "make", [fence, lambda frame: [item(5100, seq=0, frame=frame, z=47.5)]], ids=["fence", "rally"]
)
def test_polygons_circles_and_rally_points_are_verified_at_once(
    autopilot: Autopilot, frame: int, make: Callable[[int], list[MissionItem]]
) -> None:
    items = make(frame)
    kind = RALLY if items[0].command == Command.NAV_RALLY_POINT else FENCE
    wire = Wire()
    autopilot_on(wire, autopilot)
    ended = wire.run(VerifiedUpload(items, 1, autopilot=autopilot, mission_type=kind))
    assert (ended.on_board, ended.attempts, ended.error) == (OnBoard.NEW, 1, None)
