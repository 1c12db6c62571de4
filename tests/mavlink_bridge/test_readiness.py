"""Waiting for what a vehicle has to tell, and for it to let itself be armed, in virtual time."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

import pytest

from skyfolio.api.lab.virtual.loop import run
from skyfolio.mavlink_bridge import FlightMode, departure, readiness
from skyfolio.mavlink_bridge.ardupilot import ARDUCOPTER
from skyfolio.mavlink_bridge.status_texts import StatusTexts
from skyfolio.mavlink_bridge.telemetry import TelemetryState
from skyfolio.mavlink_bridge.vehicle import NotDone

ARM, TAKEOFF, REQUEST_MESSAGE = 400, 22, 512
POSITION = {"time_boot_ms": 1, "lat": 473977420, "lon": 85455940, "alt": 0, "relative_alt": 0, "vx": 0, "vy": 0}
NOWHERE = {**POSITION, "lat": 0, "lon": 0}
HEARTBEAT = {"type": 2, "autopilot": 3, "base_mode": 81, "custom_mode": 4}
GPS = {"fix_type": 3, "satellites_visible": 10}
HOME = {"latitude": 473977420, "longitude": 85455940}
BATTERY = {"battery_remaining": 90}


class Booting:
    """A vehicle as the bridge knows it, that tells and allows things at given seconds since it was switched on."""

    profile = ARDUCOPTER

    def __init__(self, *, armable_s: float = 0.0, refuses: str = "FAILED", words: str = "Arm: Need Position Estimate"):
        self.system_id = 1
        self.state = TelemetryState(1)
        self.texts = StatusTexts()
        self.armed_at_s = float("-inf")
        self.asked: list[tuple[int, float]] = []
        self.armable_s, self.refuses, self.words = armable_s, refuses, words
        self._telling: list[tuple[float, str, dict[str, Any]]] = []

    def tells(self, at_s: float, name: str, fields: dict[str, Any]) -> None:
        self._telling.append((at_s, name, fields))

    def _take_in(self) -> None:
        now_s = asyncio.get_running_loop().time()
        for one in [one for one in self._telling if one[0] <= now_s]:
            self._telling.remove(one)
            self.state.fold(one[1], one[2], now_s)

    async def command(self, number: int, *params: float | None) -> None:
        del params
        now_s = asyncio.get_running_loop().time()
        self.asked.append((number, now_s))
        if number == ARM and now_s < self.armable_s:
            self.texts.hear({"severity": 2, "text": self.words}, now_s)
            raise NotDone(f"arm: {self.refuses}")

    async def wait_until(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        until_s = asyncio.get_running_loop().time() + timeout_s
        self._take_in()
        while not condition():
            if asyncio.get_running_loop().time() >= until_s:
                return False
            await asyncio.sleep(0.1)
            self._take_in()
        return True


def waited(vehicle: Booting, waits: list[tuple[str, ...]] | None = None) -> tuple[tuple[str, ...], float]:
    return run(readiness.wait_for_facts(vehicle, (waits if waits is not None else []).append))  # type: ignore[arg-type]


def arm(vehicle: Booting, reasons: list[str], patience_s: float = 60.0) -> float:
    _, seconds = run(readiness.arm_when_ready(vehicle, patience_s, reasons.append))  # type: ignore[arg-type]
    return seconds


def test_facts_that_come_one_after_another_are_waited_for_and_each_wait_is_told() -> None:
    vehicle = Booting()
    vehicle.tells(0.0, "HEARTBEAT", HEARTBEAT)
    vehicle.tells(0.5, "GLOBAL_POSITION_INT", NOWHERE)
    vehicle.tells(1.0, "SYS_STATUS", BATTERY)
    vehicle.tells(1.0, "GPS_RAW_INT", {"fix_type": 1, "satellites_visible": 0})
    vehicle.tells(25.0, "GPS_RAW_INT", GPS)
    vehicle.tells(38.0, "GLOBAL_POSITION_INT", POSITION)
    vehicle.tells(40.0, "HOME_POSITION", HOME)
    waits: list[tuple[str, ...]] = []
    missing, seconds = waited(vehicle, waits)
    assert missing == ()
    assert 40.0 <= seconds < 42.0
    assert waits == [
        ("GPS fix", "position", "home position", "battery"),
        ("GPS fix", "position", "home position"),
        ("position", "home position"),
        ("home position",),
    ]
    assert {number for number, _ in vehicle.asked} == {REQUEST_MESSAGE}


def test_a_vehicle_that_has_told_everything_is_not_waited_for() -> None:
    vehicle = Booting()
    facts = {"HEARTBEAT": HEARTBEAT, "GLOBAL_POSITION_INT": POSITION, "SYS_STATUS": BATTERY, "GPS_RAW_INT": GPS}
    for name, fields in [*facts.items(), ("HOME_POSITION", HOME)]:
        vehicle.state.fold(name, fields, 0.0)
    missing, seconds = waited(vehicle)
    assert missing == ()
    assert seconds < 1e-3


def test_what_never_comes_is_named_when_its_time_is_over() -> None:
    vehicle = Booting()
    for name, fields in {"GLOBAL_POSITION_INT": POSITION, "GPS_RAW_INT": GPS, "HOME_POSITION": HOME}.items():
        vehicle.tells(1.0, name, fields)
    missing, seconds = waited(vehicle)
    assert missing == ("battery",)
    assert seconds == pytest.approx(readiness.TOLD_WITHIN_S, abs=0.2)
    missing, seconds = waited(Booting())
    assert missing == ("GPS fix", "position", "home position", "battery")
    assert seconds == pytest.approx(readiness.ESTIMATED_WITHIN_S, abs=0.2)


@pytest.mark.parametrize("refuses", ["FAILED", "TEMPORARILY_REJECTED", "DENIED", "TIMEOUT"])
def test_arming_is_tried_again_until_the_vehicle_lets_itself_be_armed(refuses: str) -> None:
    vehicle, reasons = Booting(armable_s=39.0, refuses=refuses), []  # type: ignore[var-annotated]
    seconds = arm(vehicle, reasons)
    assert 39.0 <= seconds <= 41.0
    assert reasons == [f"arm: {refuses} (Arm: Need Position Estimate)"]


def test_one_that_never_lets_itself_be_armed_is_named_with_its_own_words() -> None:
    vehicle, reasons = Booting(armable_s=1e9), []  # type: ignore[var-annotated]
    with pytest.raises(NotDone, match=r"arm: FAILED \(Arm: Need Position Estimate\), tried for 60 s"):
        arm(vehicle, reasons)
    assert len(vehicle.asked) <= 61


def test_an_answer_that_waiting_does_not_change_ends_it_at_once() -> None:
    vehicle = Booting(armable_s=1e9, refuses="UNSUPPORTED")
    with pytest.raises(NotDone, match="UNSUPPORTED"):
        arm(vehicle, [])
    assert len(vehicle.asked) == 1


def test_a_reason_that_changes_is_told_again_and_other_texts_do_not_explain_a_refusal() -> None:
    vehicle = Booting(armable_s=5.0)

    async def both(reasons: list[str]) -> None:
        arming = asyncio.create_task(readiness.arm_when_ready(vehicle, 60.0, reasons.append))  # type: ignore[arg-type]
        await asyncio.sleep(1.5)
        vehicle.words = "PreArm: Compass not calibrated"
        vehicle.texts.hear({"severity": 4, "text": "Low battery"}, asyncio.get_running_loop().time())
        await arming

    reasons: list[str] = []
    run(both(reasons))
    assert reasons == ["arm: FAILED (Arm: Need Position Estimate)", "arm: FAILED (PreArm: Compass not calibrated)"]


def test_nobody_takes_off_before_it_was_armed_and_knows_its_place(monkeypatch: pytest.MonkeyPatch) -> None:
    vehicle = Booting(armable_s=20.0)
    vehicle.tells(0.0, "HEARTBEAT", HEARTBEAT)

    async def mode_is_set(*_: object) -> None:
        await vehicle.wait_until(lambda: vehicle.state.mode is FlightMode.GUIDED, 1.0)

    monkeypatch.setattr(departure, "set_mode", mode_is_set)
    with pytest.raises(NotDone, match="position is not known"):
        run(departure.launch(vehicle, 20.0, 60.0))  # type: ignore[arg-type]
    assert TAKEOFF not in {number for number, _ in vehicle.asked}


def test_long_texts_come_in_chunks_and_are_quoted_whole() -> None:
    texts = StatusTexts()
    texts.hear(
        {"severity": 2, "text": "Preflight Fail: Accelerometer sensor missing on th", "id": 7, "chunk_seq": 0}, 1.0
    )
    texts.hear({"severity": 6, "text": "Ready", "id": 0, "chunk_seq": 0}, 1.0)
    texts.hear({"severity": 2, "text": "e bus\t\0", "id": 7, "chunk_seq": 1}, 1.1)
    assert texts.since(0.5) == ["Preflight Fail: Accelerometer sensor missing on the bus"]
    assert texts.since(1.05) == []
