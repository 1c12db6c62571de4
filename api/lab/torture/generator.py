"""Draws a drill from a seed: what is flown, and blows aimed at the moments at which something changes."""

from __future__ import annotations

import random
from collections.abc import Callable
from itertools import permutations
from typing import Any, get_args

from skyfolio.api.flights.journal import Step
from skyfolio.api.flights.operation_views import State
from skyfolio.api.lab.torture.aims import aim_of, aimed
from skyfolio.api.lab.torture.drill import Blow, Drill, Moment, VehicleNews
from skyfolio.api.lab.torture.stations import has_stations, with_stations
from skyfolio.mavlink_bridge import Autopilot
from skyfolio.mavlink_bridge.guidance import FallBack

Options = dict[str, Any]
STEPS = [step for step in Step if step is not Step.WAITING]
STATES = [State.UPLOADING, State.LAUNCHING, State.STARTING, State.FLYING, State.LANDING, State.LINK_LOST, State.PAUSED]
NEWS = get_args(VehicleNews)
TAKING_OFF = [State.UPLOADING, State.LAUNCHING, State.STARTING]
GROUND_SHARE = 0.2
"""Share of drills whose loss is before slot 0."""
UAVS = {"paper": 3, "minimal": 2}
FLEETS = [(one,) for one in Autopilot] + list(permutations(Autopilot, 2))
"""Autopilots that take turns in a fleet."""
_IMPAIRED = ({"loss": 0.3}, {"loss": 0.1, "burst": 4.0}, {"latency_s": 0.4}, {"cut": True}, {"duplication": 0.3})


def drill_of(seed: int) -> Drill:
    """Return the drill of this seed, always the same: left to chance, or after something (`aims`)."""
    drill, aim = _by_chance(seed), aim_of(seed)
    drill = drill if aim is None else aimed(drill, aim)
    return with_stations(drill) if has_stations(seed) else drill


def _by_chance(seed: int) -> Drill:
    chance = random.Random(f"drill/{seed}")  # noqa: S311
    example = chance.choice(("paper", "paper", "paper", "minimal"))
    slots = chance.choice((8, 12, 16))
    policy = chance.choices(("auto", "approve", "off"), (7, 2, 1))[0]
    blows = [_loss(chance, example, slots), *_more(chance, example, slots)]
    if policy == "approve":
        when = Moment(step=Step.PROPOSED, after_s=chance.choice((0.0, 0.5, 3.0)))
        blows.append(Blow(when=when, kind="decide", options={"agreed": chance.random() < 0.8}))
    return Drill(
        seed=seed,
        example=example,
        slots=slots,
        autopilots=chance.choice(FLEETS),
        policy=policy,
        loss=chance.choice((0.0, 0.0, 0.0, 0.05, 0.1)),
        gust_mps=chance.choice((0.0, 0.0, 1.0)),
        gps_m=chance.choice((0.0, 0.0, 0.5)),
        solve_s=chance.choice((0.05, 0.3, 1.5)),
        plan_ahead=chance.random() < 0.7,
        beside=chance.random() < 0.15,
        guidance=chance.choices(("mission", "stream"), (7, 3))[0],
        fall_back=chance.choice((FallBack.MISSION, FallBack.MISSION, FallBack.HOLD)),
        blows=tuple(blows),
    )


def _loss(chance: random.Random, example: str, slots: int) -> Blow:
    """Return what makes one UAV a loss, mostly in flight: without an incident there are no steps to aim at."""
    when = Moment(state=State.FLYING, after_s=_seconds(chance, slots * 5.0 * 0.7))
    if chance.random() < GROUND_SHARE:
        when = chance.choice(
            (
                Moment(state=chance.choice(TAKING_OFF), after_s=_seconds(chance, 6.0)),
                Moment(vehicle=chance.choice(("mission_accepted", "armed", "takeoff")), nth=chance.choice((1, 2))),
            )
        )
    options = chance.choice((_kill, _kill, _mute, _reboot, _human, _motor))(chance, _system(chance, example))
    return Blow(when=when, kind="vehicle", options=options)


def _more(chance: random.Random, example: str, slots: int) -> list[Blow]:
    count = chance.choices((0, 1, 2, 3), (1, 4, 3, 2))[0]
    return [_any(chance, _moment(chance, slots), example) for _ in range(count)]


def _moment(chance: random.Random, slots: int) -> Moment:
    after_s = chance.choice((0.0, 0.0, 0.0, _seconds(chance, 0.2), _seconds(chance, 4.0)))
    kind = chance.choices(("step", "state", "vehicle", "time"), (6, 3, 3, 1))[0]
    if kind == "step":
        return Moment(step=chance.choice(STEPS), stored=chance.random() < 0.5, after_s=after_s)
    if kind == "state":
        return Moment(state=chance.choice(STATES), after_s=after_s)
    if kind == "vehicle":
        return Moment(vehicle=chance.choice(NEWS), nth=chance.choice((1, 1, 2, 4)), after_s=after_s)
    return Moment(after_s=_seconds(chance, slots * 5.0 + 30.0))


def _any(chance: random.Random, when: Moment, example: str) -> Blow:
    kind = chance.choices(list(_KINDS), [weight for weight, _ in _KINDS.values()])[0]
    return Blow(when=when, kind=kind, options=_KINDS[kind][1](chance, example))


def _seconds(chance: random.Random, most_s: float) -> float:
    return round(chance.uniform(0.0, most_s), 2)


def _system(chance: random.Random, example: str) -> int:
    return chance.randint(1, UAVS[example])


def _uav(chance: random.Random, example: str) -> str:
    return f"uav-{_system(chance, example)}"


# -- faults of vehicles ------------------------------------------------------------------------------------------------


def _kill(_chance: random.Random, system_id: int) -> Options:
    return {"kind": "kill", "system_id": system_id}


def _mute(chance: random.Random, system_id: int) -> Options:
    return _for({"kind": "mute", "system_id": system_id}, chance.choice((3.0, 8.0, 20.0, None)))


def _reboot(_chance: random.Random, system_id: int) -> Options:
    return {"kind": "reboot", "system_id": system_id}


def _human(_chance: random.Random, system_id: int) -> Options:
    return {"kind": "mode_change", "system_id": system_id, "mode": "POSITION"}


def _motor(_chance: random.Random, system_id: int) -> Options:
    return {"kind": "motor_failure", "system_id": system_id}


def _freeze(chance: random.Random, system_id: int) -> Options:
    return _for({"kind": "freeze", "system_id": system_id}, chance.choice((2.0, 8.0, None)))


def _battery(chance: random.Random, system_id: int) -> Options:
    return {"kind": "low_battery", "system_id": system_id, "share": chance.choice((0.03, 0.1, 0.2))}


def _gps(chance: random.Random, system_id: int) -> Options:
    return _for({"kind": "gps_loss", "system_id": system_id}, chance.choice((3.0, 15.0, None)))


def _reject(chance: random.Random, system_id: int) -> Options:
    kind = chance.choice(("reject_mission", "corrupt_upload"))
    return {"kind": kind, "system_id": system_id, "uploads": chance.choice((1, 2, 6))}


def _jump(chance: random.Random, system_id: int) -> Options:
    return {"kind": "clock_jump", "system_id": system_id, "seconds": chance.choice((-30.0, 30.0))}


def _impair(chance: random.Random, system_id: int) -> Options:
    ways = chance.choice((("up",), ("down",), ("up", "down")))
    impaired = {way: chance.choice(_IMPAIRED) for way in ways}
    return {"kind": "impair", "system_id": system_id, **impaired, "for_s": chance.choice((3.0, 10.0, 25.0))}


def _for(options: Options, for_s: float | None) -> Options:
    return options if for_s is None else {**options, "for_s": for_s}


_FAULTS = (
    *(_kill, _mute, _mute, _reboot, _human, _motor, _freeze, _battery, _gps),
    *(_reject, _reject, _reject, _jump, _impair, _impair),
)


def _vehicle(chance: random.Random, example: str) -> Options:
    return chance.choice(_FAULTS)(chance, _system(chance, example))


# -- everything else ---------------------------------------------------------------------------------------------------


def _abort(chance: random.Random, _example: str) -> Options:
    actions = chance.choice((["hold"], ["return"], ["land"], ["land", "return"], ["hold", "land"], ["land", "land"]))
    return {"actions": actions}


def _order(chance: random.Random, example: str) -> Options:
    options: Options = {"action": chance.choice(("hold", "return", "land")), "force": chance.random() < 0.2}
    return options if chance.random() < 0.4 else {**options, "uavs": [_uav(chance, example)]}


_KINDS: dict[str, tuple[int, Callable[[random.Random, str], Options]]] = {
    "vehicle": (10, _vehicle),
    "kill_service": (6, lambda chance, _: {"down_s": chance.choice((0.2, 1.0, 3.0, 12.0))}),
    "full_disk": (2, lambda chance, _: {"for_s": chance.choice((1.0, 5.0, 30.0))}),
    "slow_disk": (2, lambda chance, _: {"commit_s": chance.choice((0.2, 0.8, 3.0)), "for_s": 10.0}),
    "clock_jump": (1, lambda chance, _: {"seconds": chance.choice((-60.0, -2.0, 2.0, 60.0))}),
    "dead_workers": (1, lambda chance, _: {"for_s": chance.choice((0.5, 5.0))}),
    "pause": (2, lambda chance, _: {"for_s": chance.choice((1.0, 8.0))}),
    "abort": (2, _abort),
    "order": (2, _order),
    "retire": (2, lambda chance, example: {"uav": _uav(chance, example)}),
    "readmit": (2, lambda chance, example: {"uav": _uav(chance, example)}),
}
"""How often each kind of blow is drawn, and its options."""
