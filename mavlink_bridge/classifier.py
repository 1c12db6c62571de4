"""Judge what happened to each UAV from the messages of its autopilot, with times and numbers as causes. Pure.

Evidence goes in message by message (`hear`), time by `poll`; changes of condition come out. Several things can be true
at once (the battery is low and the link is lost); the condition is the gravest of them, in the order of `Condition`.
Everything has to last before it counts, and longer before it is over, so that nothing flaps.

    crashed > landed > disarmed in the air > rebooted > autopilot silent, link lost > human took over > in failsafe
            > back > stale > low battery > live
"""

from __future__ import annotations

from typing import Any

from skyfolio.mavlink_bridge.announced_orders import AnnouncedOrders
from skyfolio.mavlink_bridge.autopilots import FlightMode, speaks_as_autopilot
from skyfolio.mavlink_bridge.conditions import Change, Condition, Timing
from skyfolio.mavlink_bridge.disarming import Fate
from skyfolio.mavlink_bridge.evidence import Evidence
from skyfolio.mavlink_bridge.heartbeat import AUTOPILOT, HeartbeatMonitor, LinkEvent, LinkState

_LANDING = 4
"""MAV_LANDED_STATE_LANDING."""


class Classifier:
    """Keeps the conditions of the watched UAVs. Times are fleet seconds; it has no clock and does no I/O.

    `expect(system_id, modes, now_s)` announces modes that the service is about to command, so that they are not
    attributed to a human or a failsafe. `links`: the heartbeat monitor to use (default: one with the timing's own
    limits).
    """

    def __init__(self, timing: Timing | None = None, links: HeartbeatMonitor | None = None) -> None:
        self.timing = timing or Timing()
        self.links = links or HeartbeatMonitor(
            stale_after_s=self.timing.stale_after_s,
            lost_after_s=self.timing.lost_after_s,
            recovered_after_s=self.timing.recovered_after_s,
        )
        self.link_events: list[LinkEvent] = []
        """The link events of the latest poll."""
        self._known: dict[int, Evidence] = {}
        self._conditions: dict[int, Condition] = {}
        self._announced: dict[int, AnnouncedOrders] = {}
        """Modes that were announced of systems that are not watched yet."""

    def watch(self, system_id: int, now_s: float) -> None:
        """Expect messages from this UAV from now on."""
        self.links.watch(system_id, now_s)
        if system_id not in self._known:
            orders = self._announced.pop(system_id, None)
            self._known[system_id], self._conditions[system_id] = Evidence(self.timing, orders), Condition.LIVE

    def was_flying(self, system_id: int, up_m: float, told_s: float) -> None:
        """Take in that a watched UAV was in the air when it was last heard, before this process started.

        Otherwise one that fell or landed meanwhile would be taken for one that has not taken off yet. up_m: above its
        home. told_s: when that was, minus infinity if it is not known.
        """
        if system_id in self._known:
            self._known[system_id].was_flying(up_m, told_s)

    def unwatch(self, system_id: int) -> None:
        """Stop expecting messages from this UAV and reporting changes of it."""
        self.links.unwatch(system_id)
        self._known.pop(system_id, None)
        self._conditions.pop(system_id, None)

    def condition(self, system_id: int) -> Condition:
        """Return the condition as of the latest poll. Raises KeyError if the UAV is not watched."""
        return self._conditions[system_id]

    def missed(self, now_s: float, for_s: float) -> None:
        """Take in that nothing could be received for the last `for_s` seconds; see `HeartbeatMonitor.missed`."""
        self.links.missed(now_s, for_s)
        for known in self._known.values():
            known.orders.missed(now_s, for_s)

    def silent_for_s(self, system_id: int, now_s: float) -> float:
        """Return the seconds since its autopilot was heard. Raises KeyError if the UAV is not watched."""
        return self.links.silent_for_s(system_id, now_s)

    def warning(self, system_id: int) -> str | None:
        """Return what it reports of a failsafe that changes nothing, such as one that continues its mission.

        None if it reports nothing of the kind.
        """
        known = self._known.get(system_id)
        return None if known is None else known.warning

    def is_aloft(self, system_id: int, now_s: float) -> bool:
        """Return whether it reports to be disarmed, and yet is not known to be down."""
        known = self._known.get(system_id)
        return known is not None and known.fate(now_s) in (Fate.UNKNOWN, Fate.ALOFT)

    def has_fallen(self, system_id: int, now_s: float) -> bool:
        """Return whether it reports to be disarmed, and has come down by falling; a verdict may follow later."""
        known = self._known.get(system_id)
        return known is not None and known.fate(now_s) is Fate.FALLEN

    def taken(self, system_id: int, now_s: float) -> str | None:
        """Return who else flies it at this moment, and what is seen of that; None if the service may command it.

        A human or a failsafe may. Conditions count what lasts; here one heartbeat is enough, because a command now
        would overrule it.
        """
        known = self._known.get(system_id)
        if known is None or not known.armed:
            return None
        if known.fails:
            return f"a failsafe flies it: {known.failing}"
        return f"somebody else flies it: {known.taken_over(now_s)}" if known.is_taken else None

    def expect(self, system_id: int, modes: frozenset[FlightMode], now_s: float, until_s: float | None = None) -> None:
        """Announce that one of these modes is commanded now, or that its mission ends in one.

        The change counts as ordered by the service if the mode is entered by `until_s` (None: within `expected_for_s`).
        It may be announced of a system that is not watched yet.
        """
        until_s = now_s + self.timing.expected_for_s if until_s is None else until_s
        known = self._known.get(system_id)
        orders = self._announced.setdefault(system_id, AnnouncedOrders()) if known is None else known.orders
        orders.announce(modes, now_s, until_s)

    def alive(self, system_id: int, component_id: int, now_s: float) -> None:
        """Take in that a component has sent some message, whatever it says."""
        known = self._known.get(system_id)
        if known is None:
            return
        if component_id == AUTOPILOT:
            self.links.heard(system_id, AUTOPILOT, now_s, known.height.boot_ms)
            if self.links.reboots(system_id) != known.reboot.count:
                known.note_reboot(self.links.reboots(system_id), now_s)
        else:
            known.other_heard_s, known.other_component = now_s, component_id

    def hear(self, system_id: int, component_id: int, name: str, fields: dict[str, Any], now_s: float) -> None:
        """Take in a message, fields as MAVLink names them. Unwatched systems are ignored.

        A HEARTBEAT that no aircraft's autopilot sends proves nothing, whatever component it claims to come from, not
        even that the vehicle is alive.
        """
        if (
            name == "HEARTBEAT"
            and component_id == AUTOPILOT
            and not speaks_as_autopilot(int(fields.get("type", 0)), int(fields["autopilot"]))
        ):
            return
        known = self._known.get(system_id)
        if known is not None and component_id == AUTOPILOT:
            known.fold(name, fields, now_s)
        self.alive(system_id, component_id, now_s)

    def poll(self, now_s: float) -> list[Change]:
        """Return everything that changed since the latest poll."""
        self.link_events = self.links.poll(now_s)
        changes = []
        for system_id, known in self._known.items():
            before = self._conditions[system_id]
            after, cause = self._judge(system_id, known, now_s)
            if after is not before:
                flies_on = after is Condition.REBOOTED and known.flies_on
                change = Change(
                    system_id=system_id, before=before, after=after, cause=cause, at_s=now_s, flies_on=flies_on
                )
                changes.append(change)
                self._conditions[system_id] = after
        return changes

    # -- judging ------------------------------------------------------------------------------------------------

    def _judge(self, system_id: int, known: Evidence, now_s: float) -> tuple[Condition, str]:
        """Return the gravest thing that is true, and what was seen of it."""
        silent_s = self.links.silent_for_s(system_id, now_s)
        link = self.links.state(system_id)
        self._update(known, link, silent_s, now_s)
        for judge in (self._end, self._loss, self._doing):
            verdict = judge(known, link, silent_s, now_s)
            if verdict is not None:
                return verdict
        if known.battery.on and known.charge is not None:
            return Condition.LOW_BATTERY, f"{known.charge:.0%} of charge left, low below {self.timing.low_battery:.0%}"
        return Condition.LIVE, f"heard {silent_s:.1f} s ago, in mode '{known.mode}'"

    def _update(self, known: Evidence, link: LinkState, silent_s: float, now_s: float) -> None:
        """Let time pass over what has to last; an autopilot that is not heard reports nothing new."""
        heard = link is LinkState.LIVE
        known.judge_mode(now_s)
        flying, fate = known.armed and known.flew, known.fate(now_s)
        fails, human = flying and known.fails, flying and known.is_taken_by_human
        known.human.update(human if heard and not known.may_have_ended(now_s) else None, now_s)
        known.failsafe.update(fails if heard else None, now_s)
        talks = silent_s < self.links.stale_after_s
        known.landed.update((fate is Fate.LANDED) if talks else None, now_s)
        known.aloft.update((fate is Fate.ALOFT) if talks else None, now_s)
        known.crashed.update(self._has_crashed(known, fate, now_s) if talks or known.crashed.on else None, now_s)
        known.battery.update(self._is_low(known) if heard else None, now_s)
        if link is LinkState.LOST:
            known.was_lost = True
        elif link is LinkState.LIVE:
            known.was_lost = False

    def _end(self, known: Evidence, link: LinkState, silent_s: float, now_s: float) -> tuple[Condition, str] | None:
        del link, silent_s
        height, disarmed = known.height, known.disarmed
        if known.crashed.on:
            if height.hit_mps is not None:
                came = f"came down at {height.hit_mps:.1f} m/s at {height.hit_m:.1f} m above home"
                return Condition.CRASHED, f"{came}, too fast to brake"
            falls = f"sinking at {height.sinking_mps:.1f} m/s at {height.up_m:.1f} m above home"
            return Condition.CRASHED, falls if disarmed is None else disarmed.seen(height)
        if known.landed.on:
            return Condition.LANDED, f"disarmed at {height.up_m:.1f} m above home after a flight"
        if known.aloft.on and disarmed is not None:
            return Condition.DISARMED, disarmed.seen(height)
        since_s = now_s - known.reboot.at_s
        if since_s < self.timing.rebooted_for_s and not known.may_prove(now_s, self.timing.proof_s):
            flies_on = ", and it flies its mission on" if known.flies_on else ""
            return (
                Condition.REBOOTED,
                f"its clock runs backwards, now at {(known.height.boot_ms or 0) / 1000:.1f} s since boot{flies_on}",
            )
        return None

    def _loss(self, known: Evidence, link: LinkState, silent_s: float, now_s: float) -> tuple[Condition, str] | None:
        if link is LinkState.LOST:
            other_s = now_s - known.other_heard_s
            if other_s <= self.timing.other_component_s:
                heard = f"component {known.other_component} heard {other_s:.1f} s ago"
                return Condition.AUTOPILOT_SILENT, f"autopilot silent for {silent_s:.1f} s, {heard}"
            return Condition.LINK_LOST, f"silent for {silent_s:.1f} s, lost after {self.links.lost_after_s:g} s"
        return None

    def _doing(self, known: Evidence, link: LinkState, silent_s: float, now_s: float) -> tuple[Condition, str] | None:
        if known.human.on:
            return Condition.HUMAN, known.taken_over(now_s)
        if known.failsafe.on:
            return Condition.FAILSAFE, known.failing
        if link is LinkState.STALE:
            if known.was_lost:
                steady_s = 2 * self.timing.recovered_after_s
                return Condition.BACK, f"heard again {silent_s:.1f} s ago, counts after {steady_s:g} s"
            return Condition.STALE, f"silent for {silent_s:.1f} s, stale after {self.links.stale_after_s:g} s"
        return None

    def _has_crashed(self, known: Evidence, fate: Fate | None, now_s: float) -> bool:
        """Return whether it fell; once it counts as crashed, only evident flight proves otherwise."""
        if known.crashed.on:
            return not known.evidently_flies(now_s)
        return fate is Fate.FALLEN or known.is_falling(_LANDING)

    def _is_low(self, known: Evidence) -> bool | None:
        if known.charge is None:
            return None
        return known.charge < (self.timing.full_again if known.battery.on else self.timing.low_battery)
