"""What is known of one UAV: the messages of its autopilot, folded into one record. Pure, used by `classifier`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from skyfolio.mavlink_bridge.announced_orders import AnnouncedOrders
from skyfolio.mavlink_bridge.autopilots import FlightMode
from skyfolio.mavlink_bridge.conditions import Lasting, Timing
from skyfolio.mavlink_bridge.disarming import Disarmed, Fate
from skyfolio.mavlink_bridge.height import Height
from skyfolio.mavlink_bridge.reboot import Reboot
from skyfolio.mavlink_bridge.speaker import Speaker
from skyfolio.mavlink_bridge.status_texts import StatusTexts
from skyfolio.mavlink_bridge.told_mission import ToldMission

STATE_CRITICAL = 5
"""MAV_STATE_CRITICAL of HEARTBEAT.system_status: a failsafe is active; its mode shows what it does about it."""
_LAST_STATES = frozenset({6, 8})
"""MAV_STATE_EMERGENCY and FLIGHT_TERMINATION: in these no vehicle flies a mission on."""
_HOME_MODES = frozenset({FlightMode.RETURN, FlightMode.LAND})
_ARMED = 128
_UNKNOWN = -1
_ON_GROUND = 1
"""MAV_LANDED_STATE_ON_GROUND."""
_REASONS_S = 10.0
"""Fleet seconds before a change of mode in which a STATUSTEXT may give its reason."""
_TOLD_S = 3.0
"""Fleet seconds between a change of mode and the STATUSTEXT or the system status that explains it."""
_WARNING_S = 60.0
"""Fleet seconds for which a STATUSTEXT explains a failsafe that changes nothing."""
_FLIES = frozenset(FlightMode) - {
    *(FlightMode.READY, FlightMode.TAKEOFF, FlightMode.HOLD, FlightMode.GUIDED),
    *(FlightMode.RETURN, FlightMode.LAND, FlightMode.OTHER),
}
"""Modes that do not end in hovering by themselves, or, for a mission, only when it is complete."""


class Evidence:
    """One UAV as its autopilot reports it; times are fleet seconds."""

    def __init__(self, timing: Timing, orders: AnnouncedOrders | None = None) -> None:
        self.mode = self.judged_mode = FlightMode.OTHER
        self.armed = False
        self.height = Height()
        self.texts = StatusTexts()
        self.charge: float | None = None
        self.landed_state = 0
        self.system_status = 0
        self.disarmed: Disarmed | None = None
        """Set while it reports to be disarmed, once it has flown."""
        self.other_heard_s = float("-inf")
        self.other_component = 0
        self.was_lost = False
        self.battery = Lasting(timing.battery_after_s, timing.battery_after_s)
        self._timing = timing
        self._speaker = Speaker()
        self.orders = orders or AnnouncedOrders()
        self._is_announced = False
        self._changed_s = float("-inf")
        """The time of the latest change of mode."""
        self._critical_s = float("-inf")
        """The time at which the system status last became critical."""
        self._was_critical = False
        """Whether the system status was critical before the mode changed, or with it."""
        self._was_stopped = self._may_end_mission = False
        self._mission = ToldMission(self._speaker)
        self._mode_s = float("-inf")
        self.reboot = Reboot()
        self.begin_flight()

    def begin_flight(self) -> None:
        """Begin a new flight, armed on the ground: how the flight before ended does not count any more."""
        timing = self._timing
        self.flew = False
        self.height.forget_hit()
        self.reboot.forget()
        self.human = Lasting(timing.takeover_after_s, timing.clear_after_s)
        self.failsafe = Lasting(timing.failsafe_after_s, timing.clear_after_s)
        self.landed = Lasting(timing.landed_after_s, timing.clear_after_s)
        self.aloft = Lasting(timing.crash_after_s, timing.clear_after_s)
        self.crashed = Lasting(timing.crash_after_s, timing.withdrawn_after_s)

    def was_flying(self, up_m: float, told_s: float) -> None:
        """Take in that it was in the air when an earlier process heard it last; it may have reported its end."""
        if not self.armed and self._mode_s > float("-inf"):
            self.disarmed = Disarmed(since_s=self._mode_s, up_m=up_m, told_s=told_s, landing=False)
            self.disarmed.see(self.height, self._timing)
        else:
            self.height.assume(up_m, told_s)
        self.flew, self.armed = True, self.disarmed is None

    # -- who flies it -------------------------------------------------------------------------------------------

    def judge_mode(self, now_s: float) -> None:
        """Take in a change of mode: whether the service announced it, and whether it stops a flight of the service."""
        if self.mode is self.judged_mode:
            return
        before, self.judged_mode, self._changed_s = self.judged_mode, self.mode, now_s
        self._is_announced = self.orders.entered(self.mode, now_s)
        self._may_end_mission = self.mode in _HOME_MODES and before in (FlightMode.MISSION, FlightMode.OTHER)
        profile = self._speaker.profile
        self._was_stopped = profile is not None and self.mode is profile.hold_mode and before in _FLIES

    @property
    def is_taken(self) -> bool:
        """Return whether a human or a failsafe decided what it does now: not the service, nor its mission's end."""
        profile = self._speaker.profile
        if profile is None or self._is_announced or self._ends_mission:
            return False
        return self.mode not in profile.our_modes or self._is_held

    @property
    def is_held(self) -> bool:
        """Return whether somebody else made it hover, in a mode that could be ours."""
        return self.is_taken and self._is_held

    @property
    def _ends_mission(self) -> bool:
        """Return whether it returns or lands as its mission's last item has it, which PX4 shows by its mode."""
        return self._may_end_mission and self._mission.is_finished and not self._was_critical

    def may_have_ended(self, now_s: float) -> bool:
        """Return whether it may have come to its mission's end, and MISSION_CURRENT (1 Hz) has not said so yet."""
        lately = now_s - self._changed_s < _TOLD_S
        return self._may_end_mission and lately and self._mission.may_have_finished(self._changed_s)

    @property
    def _is_held(self) -> bool:
        if not self._was_stopped:
            return False
        return self.is_critical or not (self._mission.report is None or self._mission.is_finished)

    @property
    def is_critical(self) -> bool:
        """Return whether HEARTBEAT.system_status reports a failsafe."""
        return self.system_status == STATE_CRITICAL or self.system_status in _LAST_STATES

    @property
    def is_explained(self) -> bool:
        """Return whether its autopilot has given a reason, in words, why it does something else now."""
        return bool(self.texts.about(self._changed_s, _TOLD_S, _TOLD_S))

    @property
    def fails(self) -> bool:
        """Return whether a failsafe flies it: its autopilot says so of a mode that was not commanded.

        A critical system status alone is not enough ("Continuing Auto Mode" has it too), nor is a return: anybody may
        order one.
        """
        if self.system_status in _LAST_STATES:
            return True
        if not self.is_taken:
            return False
        if abs(self._critical_s - self._changed_s) <= _TOLD_S:
            return True
        if self.mode in _HOME_MODES:
            is_low = self.charge is not None and self.charge < self._timing.low_battery
            return self._was_critical or is_low or self.is_explained
        return self.is_explained and not self.is_held

    @property
    def is_taken_by_human(self) -> bool:
        """Return whether somebody flies it or stopped it, and no failsafe of its own."""
        return self.is_taken and not self.fails and not (self.is_held and self.is_explained)

    @property
    def warning(self) -> str | None:
        """Return what it reports of a failsafe that changes nothing and lets it do what it was commanded to."""
        if not self.armed or not self.is_critical or self.is_taken or self.fails:
            return None
        text = self.texts.latest_failsafe(self._mode_s, _WARNING_S)
        return f"in mode '{self.mode}', system status {self.system_status}" + (f", said '{text}'" if text else "")

    def taken_over(self, now_s: float) -> str:
        """Return in words how it is seen to be flown."""
        if not self.is_held:
            return f"in mode '{self.mode}', which was not commanded"
        return f"in mode '{self.mode}', held by somebody else, not by this service: {self.orders.latest(now_s)}"

    @property
    def failing(self) -> str:
        """Return what is seen of its failsafe, with what it reported about it, in words."""
        texts = self.texts.about(self._changed_s, _REASONS_S, _TOLD_S)
        reason = f", said {', '.join(repr(text) for text in texts)}" if texts else ""
        charge = "" if self.charge is None else f", {self.charge:.0%} of charge left"
        return f"in mode '{self.mode}', system status {self.system_status}{reason}{charge}"

    # -- what became of it --------------------------------------------------------------------------------------

    def fate(self, now_s: float) -> Fate | None:
        """Return what became of it if it is disarmed after a flight; None while it is armed, or was not in the air."""
        return None if self.disarmed is None else self.disarmed.fate(self.height, self._timing, now_s)

    def is_falling(self, landing: int) -> bool:
        """Return whether it sinks as no landing does, by its speed and by its height, or has hit the ground so."""
        if not self.flew or not self.armed:
            return False
        if self.height.hit_mps is not None:
            return True
        return self.landed_state != landing and self.height.falling_mps > self._timing.crash_descent_mps

    def evidently_flies(self, now_s: float) -> bool:
        """Return whether it is armed, high, stays up, and does not report to be on the ground."""
        return (
            self.armed
            and self.height.is_fresh(now_s)
            and self.height.up_m > self._timing.crash_height_m
            and self.height.falling_mps < self._timing.crash_descent_mps / 2
            and self.landed_state != _ON_GROUND
        )

    def note_reboot(self, reboots: int, now_s: float) -> None:
        """Take in that its autopilot has restarted: what it flew before has to be proven anew."""
        self.reboot.note(reboots, now_s, was_flying=self.flew and self.armed, mission=self._mission.report)

    @property
    def flies_on(self) -> bool:
        """Return whether it has reported, since it restarted, that it is armed and flies the very mission of before."""
        told_s = min(self._mode_s, self._mission.told_s)
        return self.reboot.flies_on(armed=self.armed, mode=self.mode, mission=self._mission.report, told_s=told_s)

    def may_prove(self, now_s: float, within_s: float) -> bool:
        """Return whether it restarted in the air, and has time left to prove that it flies on."""
        return not self.flies_on and self.reboot.may_prove(now_s, within_s)

    # -- messages -----------------------------------------------------------------------------------------------

    def fold(self, name: str, fields: Mapping[str, Any], now_s: float) -> None:
        """Take in a message, fields as MAVLink names them; one that holds no evidence is ignored."""
        if name == "HEARTBEAT":
            self._heartbeat(fields, now_s)
        elif name in _READERS:
            _READERS[name](self, fields, now_s)

    def _heartbeat(self, fields: Mapping[str, Any], now_s: float) -> None:
        if not self._speaker.believes(fields, now_s):
            return
        self.mode, self._mode_s = self._speaker.mode_of(int(fields["custom_mode"])), now_s
        was_critical = self.is_critical
        self.system_status = int(fields.get("system_status", 0))
        if self.mode is not self.judged_mode:
            self._was_critical = was_critical or self.is_critical
        if self.is_critical and not was_critical:
            self._critical_s = now_s
        self._arming(bool(int(fields["base_mode"]) & _ARMED), now_s)
        self.judge_mode(now_s)

    def _arming(self, armed: bool, now_s: float) -> None:
        low = self.height.up_m <= self._timing.crash_height_m
        if armed and not self.armed and (low or self.landed.on):
            self.begin_flight()
        if armed:
            self.disarmed = None
            self.flew = self.flew or not low
        elif self.disarmed is not None:
            self.disarmed.beats += 1
        elif self.flew:
            self.disarmed = Disarmed.now(self.height, self.landed_state, now_s)
        self.armed = armed

    def _position(self, fields: Mapping[str, Any], now_s: float) -> None:
        self.height.hear(fields, now_s)
        if self.disarmed is not None:
            self.disarmed.see(self.height, self._timing)

    def _extended(self, fields: Mapping[str, Any], _now_s: float) -> None:
        self.landed_state = int(fields["landed_state"])

    def _sys_status(self, fields: Mapping[str, Any], _now_s: float) -> None:
        remaining = int(fields["battery_remaining"])
        self.charge = None if remaining == _UNKNOWN else remaining / 100

    def _mission_current(self, fields: Mapping[str, Any], now_s: float) -> None:
        self._mission.hear_current(fields, now_s)

    def _item_reached(self, fields: Mapping[str, Any], _now_s: float) -> None:
        self._mission.hear_reached(fields)

    def _status_text(self, fields: Mapping[str, Any], now_s: float) -> None:
        self.texts.hear(fields, now_s)


_READERS: dict[str, Callable[[Evidence, Mapping[str, Any], float], None]] = {
    "GLOBAL_POSITION_INT": Evidence._position,
    "EXTENDED_SYS_STATE": Evidence._extended,
    "SYS_STATUS": Evidence._sys_status,
    "MISSION_CURRENT": Evidence._mission_current,
    "MISSION_ITEM_REACHED": Evidence._item_reached,
    "STATUSTEXT": Evidence._status_text,
}
