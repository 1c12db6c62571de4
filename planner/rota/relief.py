"""One relief as a replan: a UAV comes up, waits beside the station, and takes it over when the other has left.

No other UAV moves differently: all others keep the paths that they are on. The reliever is silent until the hand-over,
and the relieved from then on, so that neither disturbs the users of the other. Who serves whom, and with which
bandwidth, stays open: the replan hands users over when that slot begins.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from skyfolio.planner.arrays import Array
from skyfolio.planner.changes import Changes, ReplanError
from skyfolio.planner.pinning import caught_up_m, pinned
from skyfolio.planner.pins import Pins
from skyfolio.planner.plans import Plan
from skyfolio.planner.remainder import remaining, rest_of_paths_m
from skyfolio.planner.rota.crossing import Arrival, beside, crossing
from skyfolio.planner.scenario import Point, Scenario, Uav

MOST_SLOTS = 400
"""So far ahead ways are looked for, beyond the horizon that was asked for."""


class ReliefError(ReplanError):
    """A relief that no way was found for, or that comes too early."""


@dataclass(frozen=True, kw_only=True)
class Relief:
    """What `replan` has to be given for a relief. Slots are those of the operation.

    changes, pins: its arguments. beside_at: from which slot on the reliever waits beside the station, or is there where
    no UAV is relieved. hand_over_at: the slot with which the relieved begins to leave. on_station_at: from which slot
    on the reliever is in its place. home_at: the slot in which the relieved is over its pad; None where there is none.
    """

    changes: Changes
    pins: Pins
    beside_at: int
    hand_over_at: int
    on_station_at: int
    home_at: int | None


def relief_pins(
    plan: Plan,
    *,
    at_slot: int,
    horizon: int,
    reliever: Uav,
    relieved: str | None = None,
    station_m: Point | None = None,
    pad_m: Point | None = None,
    hand_over_slot: int | None = None,
    failed: Sequence[str] = (),
    positions_m: Mapping[str, Point] | None = None,
    used_wh: Mapping[str, float] | None = None,
) -> Relief:
    """Return changes and pins with which `replan` has `reliever` take over a station from `at_slot` on.

    horizon: how many slots the new plan has at least; more where somebody is under way for longer. reliever: complete,
    `start_m` where it is in the air when `at_slot` begins. relieved: who leaves, over `pad_m` (default: its home);
    None where no UAV does: then `station_m` says which place is taken, that of a UAV that was lost. hand_over_slot:
    with which slot of the operation the relieved begins to leave; default: as soon as the reliever is beside it.
    failed, positions_m, used_wh: as for `replan`, and to be given to it too.
    Raises ReliefError where no way is found, or the hand-over would come too early, ReplanError as `remaining` does,
    and PinError for what cannot be flown, such as what the energy does not last for.
    """
    if (relieved is None) == (station_m is None):
        raise ReliefError("relieved, station_m: give who is relieved, or which station is taken; not both")
    search = horizon + MOST_SLOTS
    live = _Live(failed, positions_m, used_wh)
    air = _Air.of(plan, at_slot, search, reliever, live)
    start = air.path_of(reliever.id)[0]
    if relieved is None:
        assert station_m is not None  # noqa: S101 - one of the two is given
        way = _found(air.crossing(reliever, start, station_m, air.others_m(reliever.id)), reliever.id, "its station")
        parts = _Parts(way.slot, way.slot, way, None)
    else:
        first = None if hand_over_slot is None else hand_over_slot - at_slot
        leaving = _relieved(air, relieved)
        pad = pad_m or leaving.home_m or _pad_of(plan, relieved)
        parts = _handed_over(air, reliever, start, leaving, first, pad, at_slot)
    return _proven(plan, at_slot, horizon, reliever, relieved, live, parts)


@dataclass(frozen=True)
class _Parts:
    """Ways of a relief; slots counted from its first one."""

    beside: int
    hand_over: int
    takes_over: Arrival
    inbound: Arrival | None


@dataclass(frozen=True)
class _Live:
    """What is known of the flight: who is lost, where the others are, and what they have used; as for `replan`."""

    failed: Sequence[str]
    positions_m: Mapping[str, Point] | None
    used_wh: Mapping[str, float] | None

    def remaining(self, plan: Plan, at_slot: int, changes: Changes) -> Scenario:
        """Return the scenario of what is left of a plan from `at_slot` on."""
        scenario, _ = remaining(plan, self.failed, at_slot, self.positions_m, used_wh=self.used_wh, changes=changes)
        return scenario


@dataclass(frozen=True)
class _Air:
    """Who is where when: paths_m (U, N, 2) metres, NaN once a UAV has left, in the order of the scenario."""

    scenario: Scenario
    paths_m: Array

    @classmethod
    def of(
        cls,
        plan: Plan,
        at_slot: int,
        slots: int,
        reliever: Uav,
        live: _Live,
    ) -> _Air:
        """Return that of a plan whose UAVs hover on at its end, for so many slots."""
        scenario = live.remaining(plan, at_slot, Changes(returned=(reliever,)))
        longer = Changes(returned=(reliever,), slots=slots)
        rest_m, rows = rest_of_paths_m(plan, at_slot, longer), []
        whole = scenario.model_copy(update={"slots": slots})
        left = scenario.slots  # who leaves with the old plan's end hovers on, as others do
        for uav in scenario.uavs:
            path = caught_up_m(whole, uav, rest_m.get(uav.id, [uav.start_m] * slots))
            if uav.leaves_at_slot is not None and uav.leaves_at_slot < left:
                path[uav.leaves_at_slot :] = np.nan
            rows.append(path)
        return cls(whole, np.array(rows))

    def path_of(self, uav: str) -> list[Point]:
        """Return the path of one UAV."""
        return [(east, north) for east, north in self.paths_m[self.scenario.uav_ids.index(uav)].tolist()]

    def others_m(self, *uavs: str) -> Array:
        """Return the paths of all but these."""
        return self.paths_m[[uav not in uavs for uav in self.scenario.uav_ids]]

    def crossing(
        self, uav: Uav, here_m: Point, there_m: Point, others_m: Array, from_slot: int = 0, *, stays: bool = True
    ) -> Arrival | None:
        """Return the earliest way that is found, as `crossing` does."""
        return crossing(self.scenario, uav, here_m, there_m, others_m, from_slot=from_slot, stays=stays)


def _relieved(air: _Air, relieved: str) -> Uav:
    if relieved not in air.scenario.uav_ids:
        raise ReliefError(f"relieved: {relieved!r} is not a UAV of the plan")
    return air.scenario.uav(relieved)


def _pad_of(plan: Plan, relieved: str) -> Point:
    """Return where a UAV without a home starts, as long as the plan is the operation's first."""
    if plan.first_slot:
        raise ReliefError(f"pad_m: give where {relieved!r} lands; a replan does not know where it started")
    return plan.scenario.uav(relieved).start_m


def _found(way: Arrival | None, uav: str, where: str) -> Arrival:
    if way is None:
        raise ReliefError(f"relief: no way was found on which {uav!r} reaches {where} clear of the others")
    return way


def _handed_over(
    air: _Air, reliever: Uav, start: Point, relieved: Uav, first: int | None, pad: Point, at_slot: int
) -> _Parts:
    """Return the ways of both: the reliever waits beside the station until the relieved has left it.

    first: the slot of the hand-over, counted from the relief's; None for as soon as the reliever is beside.
    """
    staying = air.path_of(relieved.id)
    there = [place for place in staying if not np.isnan(place[0])]
    station = there[-1] if first is None else staying[first]
    if np.isnan(station[0]):
        raise ReliefError(f"relieved: {relieved.id!r} leaves by itself before it could be relieved")
    others = air.others_m(reliever.id)
    for spot in beside(air.scenario, station, start, others):
        outbound = air.crossing(reliever, start, spot, others)
        if outbound is None:
            continue
        begins = outbound.slot if first is None else first
        if begins >= len(there):
            continue  # it has left by itself by then
        if begins < outbound.slot:
            earliest = at_slot + outbound.slot
            raise ReliefError(f"hand_over_slot: {at_slot + begins} is too early, it is beside from slot {earliest} on")
        parts = _swapped(air, reliever, relieved, staying, outbound, begins, pad)
        if parts is not None:
            return parts
    raise ReliefError(
        f"relief: no way was found on which {reliever.id!r} comes beside {relieved.id!r} and takes over clear of others"
    )


def _swapped(
    air: _Air, reliever: Uav, relieved: Uav, staying: Sequence[Point], outbound: Arrival, begins: int, pad: Point
) -> _Parts | None:
    """Return the ways from the hand-over on, the relieved's first; None where one of them is not found."""
    rest = air.others_m(reliever.id, relieved.id)
    with_reliever = np.concatenate([rest, outbound.path_m[None]])
    inbound = air.crossing(relieved, staying[begins], pad, with_reliever, begins, stays=False)
    if inbound is None:
        return None
    leaving = inbound.path_m.copy()
    leaving[:begins] = staying[:begins]
    inbound = Arrival(leaving, inbound.slot)
    gone = leaving.copy()
    gone[inbound.slot + 1 :] = np.nan
    with_relieved = np.concatenate([rest, gone[None]])
    spot = outbound.path_m[-1]
    over = air.crossing(reliever, (spot[0], spot[1]), staying[begins], with_relieved, begins)
    if over is None:
        return None
    path = np.where(np.arange(len(over.path_m))[:, None] < begins, outbound.path_m, over.path_m)
    return _Parts(outbound.slot, begins, Arrival(path, over.slot), inbound)


def _proven(
    plan: Plan,
    at_slot: int,
    horizon: int,
    reliever: Uav,
    relieved: str | None,
    live: _Live,
    parts: _Parts,
) -> Relief:
    """Return the relief, its pins checked against the scenario that `replan` will make of it."""
    busy = max(parts.takes_over.slot, -1 if parts.inbound is None else parts.inbound.slot)
    slots = max(horizon, busy + 2)
    silent = reliever.model_copy(update={"on_air_from_slot": None if relieved is None else parts.hand_over})
    changes = Changes(returned=(silent,), slots=slots)
    paths = {reliever.id: parts.takes_over.path_m[:slots]}
    if relieved is not None and parts.inbound is not None:
        home = parts.inbound.path_m[: parts.inbound.slot + 1]
        paths[relieved] = home
        changes = changes.model_copy(
            update={
                "leaves_at": {relieved: at_slot + len(home)},
                "off_air_at": {relieved: at_slot + parts.hand_over},
                "ends_m": {relieved: (float(home[-1, 0]), float(home[-1, 1]))},
            }
        )
    scenario = live.remaining(plan, at_slot, changes)
    pins = Pins(
        paths_m={uav: tuple((e, n) for e, n in path.tolist()) for uav, path in paths.items()},
        uavs=tuple(uav for uav in scenario.uav_ids if uav not in paths),
    )
    pinned(scenario, pins, rest_of_paths_m(plan, at_slot, changes))
    return Relief(
        changes=changes,
        pins=pins,
        beside_at=at_slot + parts.beside,
        hand_over_at=at_slot + parts.hand_over,
        on_station_at=at_slot + parts.takes_over.slot,
        home_at=None if parts.inbound is None else at_slot + parts.inbound.slot,
    )
