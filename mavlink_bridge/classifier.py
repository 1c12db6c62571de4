"""What happened to each UAV: a pure classifier over what its autopilot says, with times and numbers as causes.

Evidence goes in message by message (`hear`), time by `poll`; out come changes of condition. Several things can be true
at once (its battery is low and the link is lost); the condition is the gravest of them, in the order of `Condition`.
Everything needs to last before it counts, and longer before it is over, so that nothing flaps.

    crashed > landed > rebooted > autopilot silent, link lost > human took over > in failsafe > back > stale
            > low battery > live
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from mavlink_bridge.autopilots import OURS, Autopilot, FlightMode, autopilot_of, mode_of
from mavlink_bridge.conditions import Change, Condition, Lasting, Timing
from mavlink_bridge.heartbeat import AUTOPILOT, HeartbeatMonitor, LinkEvent, LinkState

_STATE_CRITICAL, _STATE_EMERGENCY = 5, 6
_FAILSAFE_MODES = frozenset({FlightMode.RETURN, FlightMode.LAND})
_ARMED = 128
_LANDING = 4
_UNKNOWN = -1


class _Evidence:
    """What is known of one UAV."""

    def __init__(self, timing: Timing) -> None:
        self.condition = Condition.LIVE
        self.autopilot: Autopilot | None = None
        self.mode = self.judged_mode = FlightMode.OTHER
        self.announced = False
        self.armed = False
        self.up_m = 0.0
        self.sinking_mps = 0.0
        self.charge: float | None = None
        self.landed_state = 0
        self.system_status = 0
        self.expected: frozenset[FlightMode] = frozenset()
        self.expected_until_s = float("-inf")
        self.other_heard_s = float("-inf")
        self.other_component = 0
        self.reboots = 0
        self.rebooted_s = float("-inf")
        self.was_lost = False
        self.boot_ms: int | None = None
        self.battery = Lasting(timing.battery_after_s, timing.battery_after_s)
        self.begin_flight(timing)

    def begin_flight(self, timing: Timing) -> None:
        """It was armed: how the flight before ended is history."""
        self.flew = False
        self.human = Lasting(timing.takeover_after_s, timing.clear_after_s)
        self.failsafe = Lasting(timing.failsafe_after_s, timing.clear_after_s)
        self.landed = Lasting(timing.landed_after_s, timing.clear_after_s)
        self.falling = Lasting(timing.crash_after_s, float("inf"))

    def is_strange(self, now_s: float) -> bool:
        """Whether it is in a mode that is not ours and that we did not announce; an announced one stays right."""
        if self.mode is not self.judged_mode:
            announced = self.mode in self.expected and now_s < self.expected_until_s
            self.judged_mode, self.announced = self.mode, announced
        return self.autopilot is not None and self.mode not in OURS[self.autopilot] and not self.announced


class Classifier:
    """Conditions of the watched UAVs. Times are fleet seconds; it has no clock and does no I/O.

    `expect(system_id, modes, now_s)` announces modes we are about to command, so that they are not taken for a human's
    or a failsafe's doing. `links`: the heartbeat monitor to use (default: one with the timing's own limits).
    """

    def __init__(self, timing: Timing | None = None, links: HeartbeatMonitor | None = None) -> None:
        self.timing = timing or Timing()
        self.links = links or HeartbeatMonitor(
            stale_after_s=self.timing.stale_after_s,
            lost_after_s=self.timing.lost_after_s,
            recovered_after_s=self.timing.recovered_after_s,
        )
        self.link_events: list[LinkEvent] = []
        """What the last poll found on the links alone."""
        self._known: dict[int, _Evidence] = {}
        self._readers: dict[str, Callable[[_Evidence, dict[str, Any]], None]] = {
            "HEARTBEAT": self._heartbeat,
            "GLOBAL_POSITION_INT": _position,
            "EXTENDED_SYS_STATE": _extended,
            "SYS_STATUS": _sys_status,
        }

    def watch(self, system_id: int, now_s: float) -> None:
        """Expect this UAV from now on."""
        self.links.watch(system_id, now_s)
        self._known.setdefault(system_id, _Evidence(self.timing))

    def unwatch(self, system_id: int) -> None:
        """Expect nothing any more, and report nothing."""
        self.links.unwatch(system_id)
        self._known.pop(system_id, None)

    def condition(self, system_id: int) -> Condition:
        """As of the last poll; KeyError if not watched."""
        return self._known[system_id].condition

    def silent_for_s(self, system_id: int, now_s: float) -> float:
        """Seconds since its autopilot was heard; KeyError if not watched."""
        return self.links.silent_for_s(system_id, now_s)

    def expect(self, system_id: int, modes: frozenset[FlightMode], now_s: float) -> None:
        """We command one of these modes now, or its mission ends in one of them."""
        if system_id in self._known:
            known = self._known[system_id]
            known.expected = modes
            known.expected_until_s = now_s + self.timing.expected_for_s

    def alive(self, system_id: int, component_id: int, now_s: float) -> None:
        """Some message of a component arrived, whatever it says."""
        known = self._known.get(system_id)
        if known is None:
            return
        if component_id == AUTOPILOT:
            self.links.heard(system_id, AUTOPILOT, now_s, known.boot_ms)
        else:
            known.other_heard_s, known.other_component = now_s, component_id

    def hear(self, system_id: int, component_id: int, name: str, fields: dict[str, Any], now_s: float) -> None:
        """A message arrived, fields as MAVLink names them. Unwatched systems are ignored."""
        known = self._known.get(system_id)
        if known is not None and component_id == AUTOPILOT:
            reader = self._readers.get(name)
            if reader is not None:
                reader(known, fields)
        self.alive(system_id, component_id, now_s)

    def poll(self, now_s: float) -> list[Change]:
        """Everything that changed since the last poll."""
        self.link_events = self.links.poll(now_s)
        changes = []
        for system_id, known in self._known.items():
            after, cause = self._judge(system_id, known, now_s)
            if after is not known.condition:
                changes.append(
                    Change(system_id=system_id, before=known.condition, after=after, cause=cause, at_s=now_s)
                )
                known.condition = after
        return changes

    # -- judging ------------------------------------------------------------------------------------------------

    def _judge(self, system_id: int, known: _Evidence, now_s: float) -> tuple[Condition, str]:
        """The gravest thing that is true, and what was seen of it."""
        silent_s = self.links.silent_for_s(system_id, now_s)
        link = self.links.state(system_id)
        self._update(system_id, known, link, now_s)
        for found in (self._end, self._loss, self._doing):
            verdict = found(known, link, silent_s, now_s)
            if verdict is not None:
                return verdict
        if known.battery.on and known.charge is not None:
            return Condition.LOW_BATTERY, f"{known.charge:.0%} of charge left, low below {self.timing.low_battery:.0%}"
        return Condition.LIVE, f"heard {silent_s:.1f} s ago, in mode '{known.mode}'"

    def _update(self, system_id: int, known: _Evidence, link: LinkState, now_s: float) -> None:
        """Let time pass over what lasts; an autopilot that is not heard says nothing new."""
        heard = link is LinkState.LIVE
        stranger = known.is_strange(now_s)
        flying = known.armed and known.flew
        fails = known.system_status in (_STATE_CRITICAL, _STATE_EMERGENCY) or (
            stranger and known.mode in _FAILSAFE_MODES
        )
        known.human.update((flying and stranger and known.mode not in _FAILSAFE_MODES) if heard else None, now_s)
        known.failsafe.update((flying and fails) if heard else None, now_s)
        known.landed.update((known.flew and not known.armed and not self._is_high(known)) if heard else None, now_s)
        known.falling.update(self._is_falling(known) if heard else None, now_s)
        known.battery.update(self._is_low(known) if heard else None, now_s)
        reboots = self.links.reboots(system_id)
        if reboots != known.reboots:
            known.reboots, known.rebooted_s = reboots, now_s
        if link is LinkState.LOST:
            known.was_lost = True
        elif link is LinkState.LIVE:
            known.was_lost = False

    def _end(self, known: _Evidence, link: LinkState, silent_s: float, now_s: float) -> tuple[Condition, str] | None:
        del link, silent_s
        if known.falling.on:
            how = "disarmed" if not known.armed else f"sinking at {known.sinking_mps:.1f} m/s"
            return Condition.CRASHED, f"{how} at {known.up_m:.1f} m above home"
        if known.landed.on:
            return Condition.LANDED, f"disarmed at {known.up_m:.1f} m above home after a flight"
        if now_s - known.rebooted_s < self.timing.rebooted_for_s:
            return (
                Condition.REBOOTED,
                f"its clock runs backwards, now at {(known.boot_ms or 0) / 1000:.1f} s since boot",
            )
        return None

    def _loss(self, known: _Evidence, link: LinkState, silent_s: float, now_s: float) -> tuple[Condition, str] | None:
        if link is LinkState.LOST:
            other_s = now_s - known.other_heard_s
            if other_s <= self.timing.other_component_s:
                heard = f"component {known.other_component} heard {other_s:.1f} s ago"
                return Condition.AUTOPILOT_SILENT, f"autopilot silent for {silent_s:.1f} s, {heard}"
            return Condition.LINK_LOST, f"silent for {silent_s:.1f} s, lost after {self.links.lost_after_s:g} s"
        return None

    def _doing(self, known: _Evidence, link: LinkState, silent_s: float, now_s: float) -> tuple[Condition, str] | None:
        del now_s
        if known.human.on:
            return Condition.HUMAN, f"in mode '{known.mode}', which nobody commanded"
        if known.failsafe.on:
            return Condition.FAILSAFE, f"in mode '{known.mode}', system status {known.system_status}"
        if link is LinkState.STALE:
            if known.was_lost:
                steady_s = 2 * self.timing.recovered_after_s
                return Condition.BACK, f"heard again {silent_s:.1f} s ago, counts after {steady_s:g} s"
            return Condition.STALE, f"silent for {silent_s:.1f} s, stale after {self.links.stale_after_s:g} s"
        return None

    def _is_high(self, known: _Evidence) -> bool:
        return known.up_m > self.timing.crash_height_m

    def _is_falling(self, known: _Evidence) -> bool:
        """Disarmed in the air, or sinking as no landing does."""
        if not known.flew:
            return False
        if not known.armed:
            return self._is_high(known)
        return known.sinking_mps > self.timing.crash_descent_mps and known.landed_state != _LANDING

    def _is_low(self, known: _Evidence) -> bool | None:
        if known.charge is None:
            return None
        return known.charge < (self.timing.full_again if known.battery.on else self.timing.low_battery)

    def _heartbeat(self, known: _Evidence, fields: dict[str, Any]) -> None:
        known.autopilot = autopilot_of(int(fields["autopilot"]))
        known.mode = mode_of(known.autopilot, int(fields["custom_mode"]))
        armed = bool(int(fields["base_mode"]) & _ARMED)
        if armed and not known.armed:
            known.begin_flight(self.timing)
        known.armed = armed
        known.system_status = int(fields.get("system_status", 0))
        known.flew = known.flew or (known.armed and known.up_m > self.timing.crash_height_m)


def _position(known: _Evidence, fields: dict[str, Any]) -> None:
    known.up_m = int(fields["relative_alt"]) / 1000
    known.sinking_mps = int(fields.get("vz", 0)) / 100
    known.boot_ms = int(fields["time_boot_ms"])


def _extended(known: _Evidence, fields: dict[str, Any]) -> None:
    known.landed_state = int(fields["landed_state"])


def _sys_status(known: _Evidence, fields: dict[str, Any]) -> None:
    remaining = int(fields["battery_remaining"])
    known.charge = None if remaining == _UNKNOWN else remaining / 100
