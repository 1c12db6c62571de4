"""The UAVs that count in an operation, those that are lost and why, those that are back, and which may be commanded."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager

from skyfolio.api.common.errors import ConflictError
from skyfolio.api.fleet.own_link import Heard
from skyfolio.api.fleet.registry import Fleet
from skyfolio.api.flights.guidance import FlightGuidance
from skyfolio.api.flights.losses import Loss, really, seen, silent
from skyfolio.mavlink_bridge import FlightMode, LinkEvent, LinkState, Telemetry, geodetic_to_east_north
from skyfolio.mavlink_bridge.conditions import Condition
from skyfolio.planner import Origin
from skyfolio.planner.geometry import Point

LOW_M = 2.0
"""Metres above home; a UAV that is armed and higher than this is in the air."""

_ENDS_ON_THE_GROUND = frozenset({FlightMode.RETURN, FlightMode.LAND, FlightMode.MISSION})
"""Modes that end in a landing by themselves."""
_FELL = frozenset({"crashed", "disarmed_in_air"})


class Roster:
    """The UAVs of one flight.

    now_s: returns fleet seconds since slot 0 began. last_slot_s: returns when the last slot of a UAV begins. slot_s: of
    a slot; until so long before that slots can be flown differently, later missions return and land as planned.
    lacking: returns in words what energy a UAV lacks for its plan.
    """

    def __init__(
        self,
        systems: Mapping[str, int],
        origin: Origin,
        fleet: Fleet,
        guidance: FlightGuidance,
        *,
        now_s: Callable[[], float],
        last_slot_s: Callable[[str], float],
        slot_s: float,
        lacking: Callable[[str], str | None] = lambda _uav: None,
    ) -> None:
        self.lost: dict[str, float] = {}
        """Since when each lost UAV was not heard, or was seen to be lost; fleet seconds since slot 0."""
        self.losses: dict[str, Loss] = {}
        """Why each lost UAV is lost."""
        self.returned: set[str] = set()
        """UAVs that were lost and are heard again: offered to the operator, and not commanded."""
        self._systems, self._origin = systems, origin
        self._uavs = {system: uav for uav, system in systems.items()}
        self._fleet, self._guidance = fleet, guidance
        self._now_s, self._last_slot_s, self._slot_s = now_s, last_slot_s, slot_s
        self.own_link = fleet.own_link()
        """Judges whether a silence is that of our own link."""
        self._lacking = lacking
        self.has_news = False
        """Whether more is known of a loss than when the operation was last stored."""
        self._warned: dict[str, str] = {}
        self._last_seen_m: dict[str, Point] = {}
        self._converted: dict[str, tuple[Telemetry, Point | None]] = {}
        self._left_early: dict[str, Loss] = {}
        self._ordered: dict[str, Loss] = {}
        self.stopped = False
        """Whether the operation has ended, so that it no longer commands any vehicle."""
        self.retired: set[str] = set()
        """UAVs that were sent home by order, whatever has been seen of them since."""

    def restore(self, lost: dict[str, float], losses: dict[str, Loss], returned: set[str], retired: set[str]) -> None:
        """Take over what was known before a restart."""
        self.lost, self.returned = lost, returned
        self.losses = {uav: losses.get(uav, silent(0.0)) for uav in lost}
        self.retired = retired

    def remember(self, positions_m: Mapping[str, Point]) -> None:
        """Take in where UAVs were before a restart, metres east/north: one that is not heard again was there last."""
        self._last_seen_m |= positions_m

    @contextmanager
    def following(self) -> Iterator[asyncio.Queue[LinkEvent]]:
        """Return a queue that is sent every change of a link's state meanwhile."""
        queue = self._fleet.news.follow()
        try:
            yield queue
        finally:
            self._fleet.news.unfollow(queue)

    def newly_lost(self, queue: asyncio.Queue[LinkEvent]) -> dict[str, Loss]:
        """Return the UAVs that are lost since the last call, and why.

        A UAV is lost if it fell silent in flight, or is seen in a condition in which it cannot serve.
        """
        silent_uavs = {}
        at_m = self.positions_m()
        self._last_seen_m |= at_m
        while not queue.empty():
            event = queue.get_nowait()
            uav = self._uavs.get(event.system_id)
            if uav is None:
                continue
            if event.after == LinkState.LIVE and uav in self.losses and self.losses[uav].may_return:
                self.returned.add(uav)  # its air stays reserved: what it flies is not known yet
            if event.after == LinkState.LOST:
                self.returned.discard(uav)
        heard = self._fleet.heard()
        for uav in self._newly_silent(heard):
            silent_uavs[uav] = self._declare_lost(uav, silent(heard[self._systems[uav]].silent_for_s))
        for uav, place_m in at_m.items():
            self._guidance.airspace.seen(uav, place_m)
        self._report_warnings()
        self._note_left_early()
        ordered, self._ordered = self._ordered, {}
        return ordered | silent_uavs | self._seen_lost()

    def _newly_silent(self, heard: Mapping[int, Heard]) -> list[str]:
        """Return the UAVs in the air that are silent while others, or at least the link, are not."""
        counting = {
            uav: heard[system]
            for uav, system in self._systems.items()
            if system in heard and uav not in self.lost and not self.is_down(uav)
        }
        ours = {self._systems[uav] for uav in counting}
        others = [one for system, one in heard.items() if system not in ours]
        return self.own_link.judge(counting, others, self._fleet.now_s())

    def _report_warnings(self) -> None:
        """Report, once, what vehicles say of failsafes that change nothing."""
        for uav, system in self._systems.items():
            warning = None if uav in self.lost else self._fleet.warning(system)
            if warning is None:
                self._warned.pop(uav, None)
            elif self._warned.get(uav) != warning:
                self._warned[uav] = warning
                self._fleet.note("uav_warning", uav_id=uav, detail=warning)

    def _note_left_early(self) -> None:
        """Note UAVs that leave the plan too late for a new one: they are not lost, but have not flown all of it."""
        for uav in self._systems:
            if self._now_s() < self._last_slot_s(uav):
                loss = self._loss(uav, plan_is_flown=True)
                if loss is not None:
                    self._left_early.setdefault(uav, loss)

    def left_its_plan(self, uav: str) -> Loss | None:
        """Return why a UAV left its plan before the last slot; None if it flew it.

        If it is taken over later, by a human or its own failsafe, it has flown its plan all the same; not if it falls.
        """
        loss = self.losses.get(uav)
        if loss is not None and (self.lost[uav] < self._last_slot_s(uav) or loss.kind in _FELL):
            return loss
        return self._left_early.get(uav)

    def is_heard(self, uav: str) -> bool:
        """Return whether the link of a UAV is not lost."""
        return self._fleet.link.monitor.is_up(self._systems[uav])

    def is_stale(self, uav: str) -> bool:
        """Return whether a UAV in the air has not been heard for a while, and is not lost yet."""
        monitor, system = self._fleet.link.monitor, self._systems[uav]
        return system in monitor.watched and monitor.state(system) is LinkState.STALE and not self.is_down(uav)

    def coming_down(self) -> list[str]:
        """Return the UAVs that no longer count, are heard, and fly by themselves to where they land."""
        descending = []
        for uav in self.lost:
            telemetry = self._fleet.link.telemetry(self._systems[uav])
            if telemetry is None or not telemetry.armed or telemetry.mode not in _ENDS_ON_THE_GROUND:
                continue
            if self.is_heard(uav):
                descending.append(uav)
        return descending

    def _seen_lost(self) -> dict[str, Loss]:
        """Return the UAVs that are newly seen to be lost; update why others are lost."""
        newly_lost = {}
        for uav in self._systems:
            loss = self._loss_seen(uav)
            if loss is None:
                self._withdraw_verdict(uav)
                continue
            if uav not in self.lost:
                newly_lost[uav] = self._declare_lost(uav, loss)
            elif uav in self.returned or self.losses[uav].kind != loss.kind:
                self._update_loss(uav, loss)
            if not loss.in_the_air and self._guidance.release_air(uav):
                self._fleet.note("ghost_released", uav_id=uav, because=loss.detail)
        return newly_lost

    def _update_loss(self, uav: str, loss: Loss) -> None:
        """Note what more is known of a loss; reserve the air of a UAV that may be in the air after all."""
        was_down = not self.losses[uav].in_the_air
        self.losses[uav] = loss
        self.has_news = True
        self.returned.discard(uav)
        if was_down and loss.in_the_air:
            self._reserve(uav)

    def _withdraw_verdict(self, uav: str) -> None:
        """Offer a UAV that was seen down and evidently flies to the operator, and reserve its air."""
        loss = self.losses.get(uav)
        if loss is None or not loss.may_be_wrong or uav in self.returned:
            return
        system = self._systems[uav]
        change, telemetry = self._fleet.condition(system), self._fleet.link.telemetry(system)
        if change is None or not change.after.serves:
            return
        if telemetry is None or not telemetry.armed or telemetry.relative_alt_m <= LOW_M:
            return
        self._reserve(uav)
        self.has_news = True
        self.returned.add(uav)
        self._fleet.note(
            "verdict_withdrawn",
            uav_id=uav,
            verdict=loss.kind,
            detail=loss.detail,
            because=f"armed at {telemetry.relative_alt_m:.1f} m above home, {change.cause}",
        )

    def _declare_lost(self, uav: str, loss: Loss) -> Loss:
        """Declare a UAV lost: from now on it is neither counted on nor commanded."""
        self.lost[uav] = self._now_s() - loss.silent_for_s
        self.losses[uav] = loss
        self._guidance.leave(uav, setpoints_too=not loss.may_return)
        if loss.in_the_air:
            self._reserve(uav)
        return loss

    def _reserve(self, uav: str) -> None:
        """Reserve the air of a UAV from where it is, or was last."""
        at_m = self.last_seen_m(uav)
        if at_m is not None:
            self._guidance.reserve(uav, at_m)

    def readmit(self, uav: str) -> None:
        """Count on a UAV again that has returned."""
        self.returned.discard(uav)
        self.lost.pop(uav)
        self.losses.pop(uav)
        self._left_early.pop(uav, None)
        self.retired.discard(uav)
        self._guidance.release_air(uav)

    @property
    def low_on_battery(self) -> dict[str, str]:
        """Return the UAVs that still count and whose battery is low, and how low: the operator may send them home.

        A battery is low, too, if it no longer suffices to fly the plan and come home.
        """
        low = {}
        for uav, system in self._systems.items():
            change = self._fleet.condition(system)
            is_low = change is not None and change.after is Condition.LOW_BATTERY
            why = change.cause if change is not None and is_low else self._lacking(uav)
            if why is not None and self._may_retire(uav):
                low[uav] = why
        return low

    def _may_retire(self, uav: str) -> bool:
        return self.may_command(uav) and not self.is_down(uav)

    async def retire(self, uav: str, because: str | None = None) -> Loss:
        """Send a UAV home, and return its loss: it no longer counts.

        because: why the service does so by itself; None where the operator asked for it. Raises ConflictError if it may
        not be commanded, or does not obey.
        """
        if not self._may_retire(uav):
            raise ConflictError(f"uav_id: {uav!r} is not in the air, or is flown by somebody else")
        why = because or f"by the operator: {self.low_on_battery.get(uav, 'battery not low')}"
        system = self._systems[uav]
        error = (await self._fleet.commander.each(self._fleet.link.return_home, [system]))[system]
        if error is not None:
            raise ConflictError(f"uav_id: {uav!r} does not return: {error}")
        self.retired.add(uav)
        return self._declare_lost(uav, Loss("battery", f"sent home {why}"))

    def leave_to_operator(self, uav: str, action: str) -> None:
        """Leave a UAV alone that the operator orders apart from this operation: it no longer counts."""
        if uav not in self.lost:
            self._ordered[uav] = self._declare_lost(uav, Loss("ordered", f"ordered to {action}"))

    def may_command(self, uav: str) -> bool:
        """Return whether this operation may command the UAV now."""
        return not self.stopped and self.is_ours(uav)

    def is_ours(self, uav: str) -> bool:
        """Return whether the UAV counts.

        A human, a failsafe or a crash is never overruled, even before the loss is declared: a verdict takes seconds, a
        command that overrules a human does not.
        """
        if uav in self.lost or self._loss_seen(uav) is not None:
            return False
        return self._fleet.taken(self._systems[uav]) is None

    def _loss_seen(self, uav: str) -> Loss | None:
        """Return the loss that a UAV's condition means; None if it still counts.

        When no slot can be flown differently any more, missions end as planned.
        """
        flown = uav in self.lost or self._now_s() < self._last_slot_s(uav) - self._slot_s
        return self._loss(uav, plan_is_flown=flown)

    def _loss(self, uav: str, *, plan_is_flown: bool) -> Loss | None:
        system = self._systems[uav]
        loss, known = seen(self._fleet.condition(system), plan_is_flown=plan_is_flown), self.losses.get(uav)
        if loss is None or loss.kind != "landed":
            return loss
        if known is not None and known.kind == "crashed":
            return known  # it is on the ground, and says nothing new
        if uav in self.retired or (known is not None and known.comes_down):
            return loss  # disarmed, a PX4 shows again the mode that was chosen before it came down
        telemetry = self._fleet.link.telemetry(system)
        if telemetry is None or self._now_s() >= self._last_slot_s(uav):
            return loss
        return really(loss, telemetry.mode)

    def positions_m(self) -> dict[str, Point]:
        """Return where each UAV that knows its position was last heard, metres east/north of the scenario's origin."""
        positions_m = {}
        for uav, system in self._systems.items():
            telemetry = self._fleet.link.telemetry(system)
            if telemetry is None:
                continue
            of, at_m = self._converted.get(uav, (None, None))
            if of is not telemetry:
                at_deg = telemetry.place_deg
                at_m = None if at_deg is None else geodetic_to_east_north(self._origin, *at_deg)
                self._converted[uav] = telemetry, at_m
            if at_m is not None:
                positions_m[uav] = at_m
        return positions_m

    def last_seen_m(self, uav: str) -> Point | None:
        """Return where a UAV is, or was when its position was last known; metres east/north."""
        return self.positions_m().get(uav, self._last_seen_m.get(uav))

    def is_down(self, uav: str) -> bool:
        """Return whether a UAV last reported to be disarmed, and is not seen to be in the air."""
        return self._fleet.is_down(self._systems[uav])

    def has_landed(self, uav: str) -> bool:
        """Return whether a UAV is down, and has not fallen: one that has is lost as soon as that is certain."""
        return self.is_down(uav) and not self._fleet.has_fallen(self._systems[uav])
