"""The telemetry log: beside the data path, appended to, and its failure one message."""

from __future__ import annotations

import threading
from pathlib import Path

import pytest

from skyfolio.mavlink_bridge import tlog
from skyfolio.mavlink_bridge.tlog import TelemetryLog

FRAMES = [bytes([253, n]) for n in range(5)]


def written(path: Path, frames: list[bytes], wall_s: float) -> None:
    log = TelemetryLog(path, wall_s=lambda: wall_s)
    for frame in frames:
        log.write(frame)
    log.close()
    assert log.wait(10)


def test_each_frame_is_preceded_by_microseconds_since_1970(tmp_path: Path) -> None:
    written(tmp_path / "new" / "a.tlog", FRAMES[:2], 1.5)
    stamp = (1_500_000).to_bytes(8, "big")
    assert (tmp_path / "new" / "a.tlog").read_bytes() == stamp + FRAMES[0] + stamp + FRAMES[1]


def test_a_second_log_of_the_same_flight_is_appended(tmp_path: Path) -> None:
    written(tmp_path / "a.tlog", FRAMES[:3], 1.0)
    first = (tmp_path / "a.tlog").read_bytes()
    written(tmp_path / "a.tlog", FRAMES[3:], 2.0)
    assert (tmp_path / "a.tlog").read_bytes().startswith(first)
    assert len((tmp_path / "a.tlog").read_bytes()) == 10 * len(FRAMES)


@pytest.mark.parametrize("path", [Path("/dev/full"), Path("/dev/null/folder/a.tlog")], ids=["full disk", "no folder"])
def test_a_log_that_cannot_be_written_says_so_once_and_never_raises(path: Path) -> None:
    reasons: list[str] = []
    log = TelemetryLog(path, on_failure=reasons.append)
    for _ in range(400):
        log.write(b"x" * 300)
    log.close()
    assert log.wait(10)
    log.write(b"after the end")
    assert len(reasons) == 1
    assert reasons[0].startswith(f"{path}: ")


def test_a_disk_that_hangs_costs_frames_of_the_log_and_no_waiting(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    go_on = threading.Event()
    monkeypatch.setattr(tlog, "WAITING_FRAMES", 10)
    monkeypatch.setattr(TelemetryLog, "_write_into", lambda _self, _file: go_on.wait(10))
    reasons: list[str] = []
    log = TelemetryLog(tmp_path / "a.tlog", on_failure=reasons.append)
    for frame in FRAMES * 5:
        log.write(frame)
    log.close()
    assert len(reasons) == 1
    assert "too slow" in reasons[0]
    go_on.set()
    assert log.wait(10)
