"""The same seed gives the same flight: logs byte for byte, and a `.tlog` that pymavlink reads back"""

from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from pymavlink import mavutil

from skyfolio.sim import (
    Fleet,
    GpsLoss,
    Impairments,
    Mode,
    Mute,
    TlogWriter,
    VirtualClock,
    Weather,
    as_line,
    grid_of,
)

if TYPE_CHECKING:
    from tests.sim.conftest import Items, VirtualGcs

HOME = (47.397742, 8.545594)
ROUGH = Impairments(loss=0.1, burst=2.0, latency_s=0.05, jitter_s=0.05, duplication=0.05, reordering=0.05)
WINDY = Weather(wind_east_mps=4.0, gust_mps=1.5, gps_m=0.8)


def drill(folder: Path, seed: int, mission: list[Any], station: Callable[[Fleet], "VirtualGcs"]) -> Fleet:
    """Upload over a rough link, fly in wind, and let things go wrong; log everything to a folder."""
    folder.mkdir()
    fleet = Fleet(grid_of(3, *HOME), clock=VirtualClock(), seed=seed, weather=WINDY)
    with (folder / "truth.jsonl").open("w") as truth, TlogWriter(folder / "flight.tlog") as tlog:
        fleet.truth.sink = lambda row: print(as_line(row), file=truth)
        fleet.truth.tlog = tlog
        fleet.impair(up=ROUGH, down=ROUGH)
        fleet.inject(Mute(2), at_s=20.0)
        fleet.inject(GpsLoss(3, for_s=5.0), at_s=25.0)
        assert station(fleet).upload(mission)
        for vehicle in fleet.vehicles.values():
            vehicle.autopilot.arm()
            vehicle.autopilot.takeoff(20.0)
        fleet.step_to(15.0)
        fleet.vehicles[1].autopilot.set_mode(Mode.MISSION)
        fleet.step_to(40.0)
        fleet.truth.tlog = None
    return fleet


@pytest.fixture
def mission(items: "Items") -> list[Any]:
    return [items.speed(4.0, current=1.0), items.waypoint(40.0, 0.0), items.waypoint(40.0, 40.0)]


def test_the_same_seed_gives_the_same_bytes_and_another_seed_others(
    tmp_path: Path, mission: list[Any], virtual_gcs: Callable[[Fleet], "VirtualGcs"]
) -> None:
    for name, seed in (("a", 7), ("b", 7), ("c", 8)):
        drill(tmp_path / name, seed, mission, virtual_gcs)
    for file in ("truth.jsonl", "flight.tlog"):
        a, b, c = ((tmp_path / name / file).read_bytes() for name in "abc")
        assert a == b
        assert a != c


def test_the_tlog_is_read_back_by_pymavlink_message_by_message(
    tmp_path: Path, mission: list[Any], virtual_gcs: Callable[[Fleet], "VirtualGcs"]
) -> None:
    fleet = drill(tmp_path / "a", 7, mission, virtual_gcs)
    log: Any = mavutil.mavlink_connection(str(tmp_path / "a" / "flight.tlog"), dialect="ardupilotmega")
    names: Counter[str] = Counter()
    stamps = []
    while (message := log.recv_match()) is not None:
        names[message.get_type()] += 1
        stamps.append(message._timestamp)
    log.close()
    assert sum(names.values()) == sum(fleet.truth.sent.values()) + sum(
        m.direction == "in" for m in fleet.truth.messages
    )
    assert {"HEARTBEAT", "GLOBAL_POSITION_INT", "MISSION_COUNT", "MISSION_ITEM_INT", "MISSION_ACK"} <= set(names)
    assert "BAD_DATA" not in names
    assert stamps == sorted(stamps)
    assert stamps[-1] - stamps[0] == pytest.approx(40.0, abs=1.5)


def test_the_truth_log_holds_positions_faults_and_messages(
    tmp_path: Path, mission: list[Any], virtual_gcs: Callable[[Fleet], "VirtualGcs"]
) -> None:
    fleet = drill(tmp_path / "a", 7, mission, virtual_gcs)
    lines = (tmp_path / "a" / "truth.jsonl").read_text().splitlines()
    kept = Counter(line[: line.index(",")] for line in lines)
    assert kept == {
        '{"log":"sample"': len(fleet.truth.samples),
        '{"log":"event"': len(fleet.truth.events),
        '{"log":"message"': len(fleet.truth.messages),
    }
    assert sorted(fleet.truth.lines()) == sorted(lines)
    assert [event.detail["fault"] for event in fleet.truth.happened("fault")] == ["mute", "gps_loss"]
