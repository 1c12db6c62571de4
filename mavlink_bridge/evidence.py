"""What is known of one UAV: the messages of its autopilot, folded. Pure, used by `classifier`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from mavlink_bridge.autopilots import HOLD_MODE, OURS, Autopilot, FlightMode, autopilot_of, items_on_board, mode_of
from mavlink_bridge.conditions import Lasting, Timing

STATE_CRITICAL, STATE_EMERGENCY = 5, 6
"""MAV_STATE of HEARTBEAT.system_status."""
FAILSAFE_MODES = frozenset({FlightMode.RETURN, FlightMode.LAND})
_ARMED = 128
_UNKNOWN = -1
_UNKNOWN_TOTAL = 65535
_COMPLETE = 5
"""MISSION_STATE_COMPLETE of MISSION_CURRENT."""
_SEVERE = 3
"""MAV_SEVERITY_ERROR; critical, alert and emergency are lower numbers."""
_WORDS_S = 10.0
"""Fleet seconds for which what a STATUSTEXT said explains a failsafe."""
_TOLD_S = 3.0
"""Fleet seconds between a change of mode and the STATUSTEXT that explains it."""
_FLIES = frozenset(FlightMode) - {
    *(FlightMode.READY, FlightMode.TAKEOFF, FlightMode.HOLD, FlightMode.GUIDED),
    *(FlightMode.RETURN, FlightMode.LAND, FlightMode.OTHER),
}
"""Modes that do not end in hovering by themselves, or, for a mission, only when it is complete."""


class Evidence:
    """One UAV as its autopilot told of it; times are fleet seconds."""

    def __init__(self, timing: Timing) -> None:
        self.autopilot: Autopilot | None = None
        self.mode = self.judged_mode = FlightMode.OTHER
        self.armed = False
        self.up_m = 0.0
        self.sinking_mps = 0.0
        self.charge: float | None = None
        self.landed_state = 0
        self.system_status = 0
        self.boot_ms: int | None = None
        self.other_heard_s = float("-inf")
        self.other_component = 0
        self.was_lost = False
        self.battery = Lasting(timing.battery_after_s, timing.battery_after_s)
        self._announced: dict[FlightMode, float] = {}
        self._order: tuple[FlightMode, float] | None = None
        self._is_announced = False
        self._held_at_s: float | None = None
        self._words: tuple[str, float] | None = None
        self._mission: tuple[int, int | None, int, int] | None = None
        self._mode_s = self._mission_s = float("-inf")
        self.reboots = 0
        self._was_flying = False
        self._mission_before: tuple[int | None, int] | None = None
        self.begin_flight(timing)

    def begin_flight(self, timing: Timing) -> None:
        """It was armed: how the flight before ended is history."""
        self.flew = False
        self.rebooted_s = float("-inf")
        self.human = Lasting(timing.takeover_after_s, timing.clear_after_s)
        self.failsafe = Lasting(timing.failsafe_after_s, timing.clear_after_s)
        self.landed = Lasting(timing.landed_after_s, timing.clear_after_s)
        self.falling = Lasting(timing.crash_after_s, float("inf"))

    # -- who flies it -------------------------------------------------------------------------------------------

    def announce(self, modes: frozenset[FlightMode], now_s: float, until_s: float) -> None:
        """We command one of these modes, and it may be entered until then."""
        for mode in modes:
            self._announced.pop(mode, None)
            self._announced[mode] = until_s
            self._order = (mode, now_s)

    def judge_mode(self, now_s: float) -> None:
        """Take in a change of mode: whether it is the one we announced, and whether it stops a flight of ours."""
        if self.mode is self.judged_mode:
            return
        before, self.judged_mode = self.judged_mode, self.mode
        self._is_announced = now_s < self._announced.get(self.mode, float("-inf"))
        if self._is_announced:
            orders = list(self._announced)
            for overtaken in orders[: orders.index(self.mode)]:
                del self._announced[overtaken]
        stopped = self.autopilot is not None and self.mode is HOLD_MODE[self.autopilot] and before in _FLIES
        self._held_at_s = now_s if stopped and not self._is_announced and not self.is_critical else None

    @property
    def is_strange(self) -> bool:
        """Whether it is in a mode that is not ours and that we did not announce; an announced one stays right."""
        return self.autopilot is not None and self.mode not in OURS[self.autopilot] and not self._is_announced

    @property
    def is_held(self) -> bool:
        """Whether somebody else made it hover: not we, not a failsafe it told of, not the end of its mission."""
        if self._held_at_s is None or self._mission is None:
            return False
        seq, total, state, _ = self._mission
        finished = state == _COMPLETE or (total is not None and seq >= total - 1)
        explained = self._words is not None and abs(self._words[1] - self._held_at_s) <= _TOLD_S
        return not finished and not explained

    @property
    def is_critical(self) -> bool:
        """Whether HEARTBEAT.system_status tells of a failsafe."""
        return self.system_status in (STATE_CRITICAL, STATE_EMERGENCY)

    def taken_over(self, now_s: float) -> str:
        """What is seen of whoever flies it."""
        if not self.is_held:
            return f"in mode '{self.mode}', which nobody commanded"
        order = "no order of ours" if self._order is None else _order_words(*self._order, now_s)
        return f"in mode '{self.mode}', held by somebody else, not by us: {order}"

    def failing(self, now_s: float) -> str:
        """What is seen of its failsafe, with what it said about it."""
        said = ""
        if self._words is not None and now_s - self._words[1] <= _WORDS_S:
            said = f", said '{self._words[0]}' {now_s - self._words[1]:.1f} s ago"
        charge = "" if self.charge is None else f", {self.charge:.0%} of charge left"
        return f"in mode '{self.mode}', system status {self.system_status}{said}{charge}"

    # -- after a reboot -----------------------------------------------------------------------------------------

    def note_reboot(self, reboots: int, now_s: float) -> None:
        """Its autopilot has restarted: what it flew before has to be proven anew."""
        self.reboots, self.rebooted_s = reboots, now_s
        self._was_flying = self.flew and self.armed
        mission = self._mission
        self._mission_before = None if mission is None else (mission[1], mission[3])

    @property
    def flies_on(self) -> bool:
        """Whether it has told, since it restarted, that it is armed and flies the very mission it flew before."""
        if not self._was_flying or self._mission is None or self._mission_before is None:
            return False
        told = min(self._mode_s, self._mission_s) > self.rebooted_s
        same = (self._mission[1], self._mission[3]) == self._mission_before
        return told and same and self.armed and self.mode is FlightMode.MISSION

    def may_prove(self, now_s: float, within_s: float) -> bool:
        """Whether it was in the air when it restarted, and there is time left to prove that it flies on."""
        return self._was_flying and not self.flies_on and now_s - self.rebooted_s < within_s

    # -- messages -----------------------------------------------------------------------------------------------

    def fold(self, name: str, fields: Mapping[str, Any], now_s: float, timing: Timing) -> None:
        """Take in a message, fields as MAVLink names them; those it has no use for are ignored."""
        if name == "HEARTBEAT":
            self._heartbeat(fields, now_s, timing)
        elif name in _READERS:
            _READERS[name](self, fields, now_s)

    def _heartbeat(self, fields: Mapping[str, Any], now_s: float, timing: Timing) -> None:
        self.autopilot = autopilot_of(int(fields["autopilot"]))
        self.mode, self._mode_s = mode_of(self.autopilot, int(fields["custom_mode"])), now_s
        armed = bool(int(fields["base_mode"]) & _ARMED)
        if armed and not self.armed:
            self.begin_flight(timing)
        self.armed = armed
        self.system_status = int(fields.get("system_status", 0))
        self.flew = self.flew or (self.armed and self.up_m > timing.crash_height_m)

    def _position(self, fields: Mapping[str, Any], _now_s: float) -> None:
        self.up_m = int(fields["relative_alt"]) / 1000
        self.sinking_mps = int(fields.get("vz", 0)) / 100
        self.boot_ms = int(fields["time_boot_ms"])

    def _extended(self, fields: Mapping[str, Any], _now_s: float) -> None:
        self.landed_state = int(fields["landed_state"])

    def _sys_status(self, fields: Mapping[str, Any], _now_s: float) -> None:
        remaining = int(fields["battery_remaining"])
        self.charge = None if remaining == _UNKNOWN else remaining / 100

    def _mission_current(self, fields: Mapping[str, Any], now_s: float) -> None:
        told = items_on_board(self.autopilot, int(fields.get("total", _UNKNOWN_TOTAL)))
        state, identity = int(fields.get("mission_state", 0)), int(fields.get("mission_id", 0))
        self._mission, self._mission_s = (int(fields["seq"]), told, state, identity), now_s

    def _status_text(self, fields: Mapping[str, Any], now_s: float) -> None:
        if int(fields["severity"]) <= _SEVERE:
            self._words = (str(fields["text"]).rstrip("\0"), now_s)


def _order_words(mode: FlightMode, at_s: float, now_s: float) -> str:
    return f"our last order was '{mode}' {now_s - at_s:.1f} s ago"


_READERS: dict[str, Callable[[Evidence, Mapping[str, Any], float], None]] = {
    "GLOBAL_POSITION_INT": Evidence._position,
    "EXTENDED_SYS_STATE": Evidence._extended,
    "SYS_STATUS": Evidence._sys_status,
    "MISSION_CURRENT": Evidence._mission_current,
    "STATUSTEXT": Evidence._status_text,
}
