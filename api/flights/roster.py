"""Who still flies for an operation: who is lost and why, who is back, and who may be commanded."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager

from skyfolio.api.common.errors import ConflictError
from skyfolio.api.fleet.own_link import Heard
from skyfolio.api.fleet.registry import Fleet
from skyfolio.api.flights.guidance import FlightGuidance
from skyfolio.api.flights.losses import Loss, seen, silent
from skyfolio.api.flights.rates import Point
from skyfolio.mavlink_bridge import FlightMode, LinkEvent, LinkState, geodetic_to_east_north
from skyfolio.mavlink_bridge.conditions import Condition
from skyfolio.planner import Origin

LOW_M = 2.0
"""Metres above home; who is armed and higher than this is in the air."""

_ENDS_ON_THE_GROUND = frozenset({FlightMode.RETURN, FlightMode.LAND, FlightMode.MISSION})
"""Modes that end in a landing by themselves."""
_FELL = frozenset({"crashed", "disarmed_in_air"})


class Roster:
    """The UAVs of one flight. `now_s()`: fleet seconds since slot 0 began.

    last_change_s: until then slots can be flown differently; later, missions return and land as planned. last_slot_s:
    when the last slot begins.
    """

    def __init__(
        self,
        systems: Mapping[str, int],
        origin: Origin,
        fleet: Fleet,
        guidance: FlightGuidance,
        *,
        now_s: Callable[[], float],
        last_change_s: float,
        last_slot_s: float,
    ) -> None:
        self.lost: dict[str, float] = {}
        """Since when each that is lost was not heard, or was seen lost."""
        self.losses: dict[str, Loss] = {}
        """Why each that is lost is."""
        self.returned: set[str] = set()
        """UAVs that were lost and are heard again: offered to the operator, not commanded."""
        self._systems, self._origin = systems, origin
        self._uavs = {system: uav for uav, system in systems.items()}
        self._fleet, self._guidance = fleet, guidance
        self._now_s, self._last_change_s, self._last_slot_s = now_s, last_change_s, last_slot_s
        self.own_link = fleet.own_link()
        """Whether judgement is held because nobody at all is heard."""
        self._warned: dict[str, str] = {}
        self._last_seen_m: dict[str, Point] = {}
        self._broke_off: dict[str, Loss] = {}
        self._ordered: dict[str, Loss] = {}
        self.stopped = False
        """Whether the operation has ended, so that it commands nobody any more."""
        self.retired: set[str] = set()
        """UAVs that were sent home by order, whatever is seen of them since."""

    def restore(self, lost: dict[str, float], losses: dict[str, Loss], returned: set[str], retired: set[str]) -> None:
        """Take over what was known before a restart."""
        self.lost, self.returned = lost, returned
        self.losses = {uav: losses.get(uav, silent(0.0)) for uav in lost}
        self.retired = retired

    @contextmanager
    def following(self) -> Iterator[asyncio.Queue[LinkEvent]]:
        """A queue that gets every link event meanwhile."""
        queue = self._fleet.news.follow()
        try:
            yield queue
        finally:
            self._fleet.news.unfollow(queue)

    def newly_lost(self, queue: asyncio.Queue[LinkEvent]) -> dict[str, Loss]:
        """UAVs that are lost since the last call, and why: fallen silent in flight, or seen in no state to serve."""
        found = {}
        self._last_seen_m |= self.positions_m()
        while not queue.empty():
            event = queue.get_nowait()
            uav = self._uavs.get(event.system_id)
            if uav is None:
                continue
            if event.after == LinkState.LIVE and uav in self.losses and self.losses[uav].may_return:
                self.returned.add(uav)  # its air stays reserved: nobody knows yet what it flies
            if event.after == LinkState.LOST:
                self.returned.discard(uav)
        for uav in self._newly_silent():
            found[uav] = self._lose(uav, silent(self._heard()[uav].silent_for_s))
        for uav, at_m in self.positions_m().items():
            self._guidance.airspace.seen(uav, at_m)
        self._warn()
        self._note_broken_off()
        ordered, self._ordered = self._ordered, {}
        return ordered | found | self._seen_lost()

    def _heard(self) -> dict[str, Heard]:
        heard = self._fleet.heard()
        return {uav: heard[system] for uav, system in self._systems.items() if system in heard}

    def _newly_silent(self) -> list[str]:
        """UAVs in the air that are silent while others, or the link at least, are not."""
        counting = {
            uav: heard for uav, heard in self._heard().items() if uav not in self.lost and not self.is_down(uav)
        }
        ours = {self._systems[uav] for uav in counting}
        others = [heard for system, heard in self._fleet.heard().items() if system not in ours]
        return self.own_link.judge(counting, others, self._fleet.now_s())

    def _warn(self) -> None:
        """Tell, once, what vehicles say of failsafes that change nothing."""
        for uav, system in self._systems.items():
            said = None if uav in self.lost else self._fleet.warning(system)
            if said is None:
                self._warned.pop(uav, None)
            elif self._warned.get(uav) != said:
                self._warned[uav] = said
                self._fleet.note("uav_warning", uav_id=uav, detail=said)

    def _note_broken_off(self) -> None:
        """Who leaves its plan when nothing can be flown differently any more is not lost, but has not flown it all."""
        if self._now_s() < self._last_slot_s:
            for uav in self._systems:
                loss = seen(self._fleet.condition(self._systems[uav]), plan_is_flown=True)
                if loss is not None:
                    self._broke_off.setdefault(uav, loss)

    def left_its_plan(self, uav: str) -> Loss | None:
        """Why a UAV left its plan before the last slot; None for one that flew it.

        Whoever flies it after that, a human or its own failsafe, takes nothing from what it has flown; a fall does.
        """
        loss = self.losses.get(uav)
        if loss is not None and (self.lost[uav] < self._last_slot_s or loss.kind in _FELL):
            return loss
        return self._broke_off.get(uav)

    def is_heard(self, uav: str) -> bool:
        """Whether its link is not lost."""
        system, monitor = self._systems[uav], self._fleet.link.monitor
        return system in monitor.watched and monitor.state(system) is not LinkState.LOST

    def coming_down(self) -> list[str]:
        """UAVs that count no more, are heard, and fly by themselves to where they land."""
        found = []
        for uav in self.lost:
            said = self._fleet.link.telemetry(self._systems[uav])
            if said is not None and said.armed and said.mode in _ENDS_ON_THE_GROUND and self.is_heard(uav):
                found.append(uav)
        return found

    def _seen_lost(self) -> dict[str, Loss]:
        """UAVs newly seen crashed, landed off plan, flown by a human or in failsafe; who is lost gets a cause."""
        found = {}
        for uav in self._systems:
            loss = self._seen(uav)
            if loss is None:
                self._take_back(uav)
                continue
            if uav not in self.lost:
                found[uav] = self._lose(uav, loss)
            elif uav in self.returned or self.losses[uav].kind != loss.kind:
                self._learn(uav, loss)
            if not loss.in_the_air and self._guidance.release_air(uav):
                self._fleet.note("ghost_released", uav_id=uav, because=loss.detail)
        return found

    def _learn(self, uav: str, loss: Loss) -> None:
        """More is known of why it is lost; who may be in the air after all has its air again."""
        was_down = not self.losses[uav].in_the_air
        self.losses[uav] = loss
        self.returned.discard(uav)
        if was_down and loss.in_the_air:
            self._reserve(uav)

    def _take_back(self, uav: str) -> None:
        """It was seen down, and evidently flies: its air is reserved, and it is offered to the operator."""
        loss = self.losses.get(uav)
        if loss is None or not loss.may_be_wrong or uav in self.returned:
            return
        change, said = self._fleet.condition(self._systems[uav]), self._fleet.link.telemetry(self._systems[uav])
        if change is None or not change.after.serves or said is None or not said.armed or said.relative_alt_m <= LOW_M:
            return
        self._reserve(uav)
        self.returned.add(uav)
        self._fleet.note(
            "verdict_withdrawn",
            uav_id=uav,
            verdict=loss.kind,
            detail=loss.detail,
            because=f"armed at {said.relative_alt_m:.1f} m above home, {change.cause}",
        )

    def _lose(self, uav: str, loss: Loss) -> Loss:
        """From now on it is neither counted on nor commanded."""
        self.lost[uav] = self._now_s() - loss.silent_for_s
        self.losses[uav] = loss
        self._guidance.leave(uav, setpoints_too=not loss.may_return)
        if loss.in_the_air:
            self._reserve(uav)
        return loss

    def _reserve(self, uav: str) -> None:
        """Its air is nobody else's, from where it is or last was."""
        where = self.last_seen_m(uav)
        if where is not None:
            self._guidance.reserve(uav, where)

    def readmit(self, uav: str) -> None:
        """Count on a UAV again that has returned."""
        self.returned.discard(uav)
        self.lost.pop(uav)
        self.losses.pop(uav)
        self._broke_off.pop(uav, None)
        self.retired.discard(uav)
        self._guidance.release_air(uav)

    @property
    def low_on_battery(self) -> dict[str, str]:
        """UAVs that still count and whose battery is low, and how low: the operator may send them home."""
        low = {}
        for uav, system in self._systems.items():
            change = self._fleet.condition(system)
            if change is not None and change.after is Condition.LOW_BATTERY and self._may_retire(uav):
                low[uav] = change.cause
        return low

    def _may_retire(self, uav: str) -> bool:
        return self.may_command(uav) and not self.is_down(uav)

    async def retire(self, uav: str) -> Loss:
        """Send a UAV home; from then on it counts no more. Raises ConflictError when it is not ours, or does not go."""
        if not self._may_retire(uav):
            raise ConflictError(f"uav_id: {uav!r} is not in the air, or not ours to command")
        because = self.low_on_battery.get(uav, "no low battery")
        system = self._systems[uav]
        error = (await self._fleet.commander.each(self._fleet.link.return_home, [system]))[system]
        if error is not None:
            raise ConflictError(f"uav_id: {uav!r} does not return: {error}")
        self.retired.add(uav)
        return self._lose(uav, Loss("battery", f"sent home by the operator: {because}"))

    def leave_to_operator(self, uav: str, action: str) -> None:
        """The operator commands it, apart from this operation: it counts no more, and is told nothing any more."""
        if uav not in self.lost:
            self._ordered[uav] = self._lose(uav, Loss("ordered", f"told to {action} by order"))

    def may_command(self, uav: str) -> bool:
        """Whether this operation may command it now."""
        return not self.stopped and self.is_ours(uav)

    def is_ours(self, uav: str) -> bool:
        """Whether it counts: a human, a failsafe or a crash is never overruled, not even before it is declared."""
        return uav not in self.lost and self._seen(uav) is None

    def _seen(self, uav: str) -> Loss | None:
        """What it is seen in that ends its service. Once no slot can be flown differently, missions end as planned."""
        flown = uav in self.lost or self._now_s() < self._last_change_s
        return seen(self._fleet.condition(self._systems[uav]), plan_is_flown=flown)

    def positions_m(self) -> dict[str, Point]:
        """Where each UAV that knows its place was last heard, metres east/north of the scenario's origin."""
        found = {}
        for uav, system in self._systems.items():
            said = self._fleet.link.telemetry(system)
            if said is not None and said.place_deg is not None:
                found[uav] = geodetic_to_east_north(self._origin, *said.place_deg)
        return found

    def last_seen_m(self, uav: str) -> Point | None:
        """Where a UAV is, or was when it last knew its place."""
        return self.positions_m().get(uav, self._last_seen_m.get(uav))

    def is_down(self, uav: str) -> bool:
        """Whether it last said that it is disarmed, and is not seen to be in the air all the same."""
        return self._fleet.is_down(self._systems[uav])
