"""Aims: what a whole drill is after, where blows that strike one by one rarely come together.

Half of all drills have one of the first, each its turn, every eighth of the others one of those that were added later,
and from seed 1500 on another eighth one of the newest, so that a campaign reaches every state with every fault that
hurts there: an upload that is refused while a UAV is lost, an order in the moments in which a mission is sent, a second
loss during a recovery. The others are left to chance.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from typing import Any

from skyfolio.api.flights.journal import Step
from skyfolio.api.flights.operation_views import State
from skyfolio.api.lab.torture.drill import Blow, Drill, Moment
from skyfolio.mavlink_bridge import Autopilot, OnEnd

Changes = dict[str, Any]
Aim = Callable[[random.Random], Changes]
AIMS: dict[str, Aim] = {}
"""What a drill may be after, by name; each returns what it changes of a drill that is otherwise left to chance."""
UAVS, SLOT_S = 3, 5.0
BEFORE_SENDING = (Step.DETECTED, Step.CLASSIFIED, Step.REPLANNED, Step.CHECKED)
_RECOVERY: Changes = {
    "example": "paper",
    "slots": 16,
    "policy": "auto",
    "guidance": "mission",
    "beside": False,
    "loss": 0.0,
}
"""A flight that leaves time to deal with a loss."""
_FAR: Changes = {"latency_s": 0.1}
"""A link on which it takes a second or two to send a mission, so that something may happen meanwhile."""
_SLOW_SOLVES: Changes = {"solve_s": 1.5, "plan_ahead": False}


def aim_of(seed: int) -> str | None:
    """Return the name of what the drill of this seed is after; None if it is left to chance."""
    half, odd = divmod(seed, 2)
    if not odd:
        return _FIRST[half % len(_FIRST)]
    turn, rest = divmod(half, _LATER_EVERY)
    if rest == _NEWEST_REST and seed >= NEWEST_FROM:
        return NEWEST[turn % len(NEWEST)]
    return LATER[turn % len(LATER)] if rest == _LATER_REST else None


def aimed(drill: Drill, aim: str) -> Drill:
    """Return the drill with what it is after."""
    chance = random.Random(f"aim/{drill.seed}")  # noqa: S311
    return drill.model_copy(update=AIMS[aim](chance))


def _aim(function: Aim) -> Aim:
    AIMS[function.__name__.removeprefix("_")] = function
    return function


# -- losses ------------------------------------------------------------------------------------------------------------


@_aim
def _two_losses_at_once(chance: random.Random) -> Changes:
    one, other, _ = _uavs(chance)
    when = _in_flight(chance, 3.0, 20.0)
    return {**_RECOVERY, "plan_ahead": True, "blows": (_kill(when, one), _kill(when, other))}


@_aim
def _two_losses_in_turn(chance: random.Random) -> Changes:
    one, other, _ = _uavs(chance)
    first_s = _seconds(chance, 3.0, 12.0)
    second_s = round(first_s + _seconds(chance, 11.0, 25.0), 2)
    return {**_RECOVERY, "blows": (_gone(chance, _flying(first_s), one), _gone(chance, _flying(second_s), other))}


@_aim
def _a_loss_while_recovering(chance: random.Random) -> Changes:
    one, other, _ = _uavs(chance)
    first_s = _seconds(chance, 3.0, 15.0)
    second_s = round(first_s + _seconds(chance, 0.1, 2.0), 2)
    return {**_RECOVERY, **_SLOW_SOLVES, "blows": (_kill(_flying(first_s), one), _kill(_flying(second_s), other))}


@_aim
def _killed_about_a_verdict(chance: random.Random) -> Changes:
    one, _, _ = _uavs(chance)
    gone_s = _seconds(chance, 3.0, 20.0)
    killed = _killed_service(chance, _flying(round(gone_s + _seconds(chance, 0.1, 8.0), 2)))
    gone = _human if chance.random() < 0.6 else _kill
    return {**_RECOVERY, "blows": (gone(_flying(gone_s), one), killed)}


@_aim
def _readmitted(chance: random.Random) -> Changes:
    back, gone, _ = _uavs(chance)
    mute = Blow(
        when=_in_flight(chance, 1.0, 6.0), kind="vehicle", options={"kind": "mute", "system_id": back, "for_s": 8.0}
    )
    first, second = Moment(step=Step.CLOSED, nth=1), Moment(step=Step.CLOSED, nth=2)
    readmit = {"uav": f"uav-{back}"}
    blows = [mute]
    if chance.random() < 0.6:
        blows.append(_kill(first, gone))
        blows.append(Blow(when=_after(second, _seconds(chance, 1.0, 8.0)), kind="readmit", options=readmit))
    else:
        blows.append(Blow(when=_after(first, _seconds(chance, 7.0, 14.0)), kind="readmit", options=readmit))
    return {**_RECOVERY, "blows": tuple(blows)}


# -- the end of the service --------------------------------------------------------------------------------------------


@_aim
def _killed_while_recovering(chance: random.Random) -> Changes:
    steps = (*BEFORE_SENDING, Step.UPLOADING, Step.UPLOADING, Step.UPLOADING, Step.VERIFIED, Step.FLYING, Step.CLOSED)
    when = Moment(step=chance.choice(steps), stored=chance.random() < 0.7, after_s=chance.choice((0.0, 0.0, 0.1, 0.5)))
    return {
        **_RECOVERY,
        "latency_s": chance.choice((0.0, 0.1)),
        "blows": (_early_kill(chance), _killed_service(chance, when)),
    }


@_aim
def _killed_after_a_recovery(chance: random.Random) -> Changes:
    one, other, _ = _uavs(chance)
    down_s = chance.choice((0.2, 1.0, 3.0))
    killed_s = _seconds(chance, 0.3, 6.0)
    closed = Moment(step=Step.CLOSED)
    again = _after(closed, round(killed_s + down_s + _seconds(chance, 0.5, 8.0), 2))
    killed = Blow(when=_after(closed, killed_s), kind="kill_service", options={"down_s": down_s})
    return {**_RECOVERY, "blows": (_kill(_in_flight(chance, 1.0, 6.0), one), killed, _gone(chance, again, other))}


@_aim
def _killed_while_a_vehicle_does_not_answer(chance: random.Random) -> Changes:
    when = _in_flight(chance, 1.0, 20.0)
    cut = {"kind": "impair", "system_id": chance.randint(1, UAVS), "up": {"cut": True}, "for_s": 25.0}
    blows = (_killed_service(chance, when), Blow(when=when, kind="vehicle", options=cut))
    return {**_RECOVERY, "guidance": chance.choice(("mission", "stream")), "blows": blows}


@_aim
def _killed_while_the_disk_is_slow(chance: random.Random) -> Changes:
    slow = {"commit_s": chance.choice((0.4, 0.8)), "for_s": 20.0}
    step = chance.choice((*BEFORE_SENDING, Step.UPLOADING))
    when = Moment(step=step, stored=True, after_s=_seconds(chance, 0.0, 0.35))
    blows = (
        _early_kill(chance),
        Blow(when=Moment(step=Step.DETECTED, stored=False), kind="slow_disk", options=slow),
        _killed_service(chance, when),
    )
    return {**_RECOVERY, "blows": blows}


@_aim
def _killed_after_the_disk_was_full(chance: random.Random) -> Changes:
    one, other, _ = _uavs(chance)
    full_s = chance.choice((1.0, 3.0))
    when = Moment(step=chance.choice(BEFORE_SENDING), stored=False)
    blows = (
        _kill(_in_flight(chance, 1.0, 6.0), one),
        Blow(when=when, kind="slow_disk", options={"commit_s": 0.4, "for_s": full_s}),
        Blow(when=when, kind="full_disk", options={"for_s": full_s}),
        _kill(Moment(step=Step.CLOSED, after_s=2.0), other),
        _killed_service(chance, Moment(step=Step.CLOSED, nth=2, after_s=_seconds(chance, 0.5, 4.0))),
    )
    return {**_RECOVERY, "blows": blows}


# -- the operator ------------------------------------------------------------------------------------------------------


@_aim
def _an_order_while_recovering(chance: random.Random) -> Changes:
    step = chance.choice((*BEFORE_SENDING, Step.UPLOADING, Step.CLOSED))
    when = Moment(step=step, stored=chance.random() < 0.5, after_s=chance.choice((0.0, 0.0, 0.1, 0.4)))
    order = chance.choice(("pause", "pause", "abort", "retire"))
    options: dict[str, Changes] = {
        "pause": {"for_s": chance.choice((2.0, 6.0))},
        "abort": {"actions": [chance.choice(("hold", "land", "return"))]},
        "retire": {"uav": f"uav-{chance.randint(1, UAVS)}"},
    }
    blow = Blow(when=when, kind=order, options=options[order])
    return {**_RECOVERY, **_SLOW_SOLVES, **_FAR, "blows": (_early_kill(chance), blow)}


@_aim
def _an_order_while_missions_are_sent(chance: random.Random) -> Changes:
    gone, one, _ = _uavs(chance)
    when = Moment(step=Step.UPLOADING, after_s=_seconds(chance, 0.1, 1.2))
    options = {"action": chance.choice(("hold", "land", "return")), "uavs": [f"uav-{one}"]}
    order = Blow(when=when, kind="order", options=options)
    return {**_RECOVERY, **_FAR, "blows": (_kill(_in_flight(chance, 1.0, 15.0), gone), order)}


@_aim
def _a_pause_and_an_abort(chance: random.Random) -> Changes:
    when = Moment(step=Step.UPLOADING, after_s=_seconds(chance, 0.0, 0.4))
    pause = Blow(when=when, kind="pause", options={"for_s": 4.0})
    action = chance.choice(("hold", "land", "return"))
    abort = Blow(when=_after(when, _seconds(chance, 0.02, 0.3)), kind="abort", options={"actions": [action]})
    return {**_RECOVERY, **_FAR, "blows": (_early_kill(chance), pause, abort)}


@_aim
def _two_aborts(chance: random.Random) -> Changes:
    actions = chance.sample(("hold", "land", "return"), 2)
    blow = Blow(when=_in_flight(chance, 0.0, 20.0), kind="abort", options={"actions": actions})
    return {**_RECOVERY, "plan_ahead": True, "solve_s": 1.5, "blows": (blow,)}


@_aim
def _a_pause_in_flight(chance: random.Random) -> Changes:
    pause = Blow(when=_in_flight(chance, 8.0, 35.0), kind="pause", options={"for_s": chance.choice((3.0, 8.0))})
    return {**_RECOVERY, "slots": 12, "blows": (pause,)}


@_aim
def _asked_and_declined(chance: random.Random) -> Changes:
    when = Moment(step=Step.PROPOSED, after_s=chance.choice((0.0, 0.5)))
    declined = Blow(when=when, kind="decide", options={"agreed": False})
    closes = Moment(step=Step.CLOSED, stored=False)
    slow = Blow(when=closes, kind="slow_disk", options={"commit_s": 0.4, "for_s": 5.0})
    when = _after(closes, _seconds(chance, 0.0, 0.2))
    order = Blow(when=when, kind="pause", options={"for_s": 3.0})
    if chance.random() < 0.5:
        order = Blow(when=when, kind="abort", options={"actions": ["land"]})
    return {**_RECOVERY, "policy": "approve", "blows": (_early_kill(chance), declined, slow, order)}


# -- uploads, links and ends -------------------------------------------------------------------------------------------


@_aim
def _refused_in_flight(chance: random.Random) -> Changes:
    gone, one, other = _uavs(chance)
    refusing = (one, other) if chance.random() < 0.3 else (one,)
    when = Moment(step=chance.choice((Step.DETECTED, Step.UPLOADING)), stored=False)
    kind, uploads = chance.choice(("reject_mission", "corrupt_upload")), chance.choice((1, 2, 4, 8, 60))
    refused = (
        Blow(when=when, kind="vehicle", options={"kind": kind, "system_id": uav, "uploads": uploads})
        for uav in refusing
    )
    return {**_RECOVERY, "blows": (_kill(_in_flight(chance, 1.0, 15.0), gone), *refused)}


@_aim
def _refused_on_the_ground(chance: random.Random) -> Changes:
    kind, uploads = chance.choice(("reject_mission", "corrupt_upload")), chance.choice((1, 3, 20))
    options = {"kind": kind, "system_id": chance.randint(1, UAVS), "uploads": uploads}
    return {**_RECOVERY, "blows": (Blow(when=Moment(state=State.UPLOADING), kind="vehicle", options=options),)}


@_aim
def _a_bad_link_while_missions_are_sent(chance: random.Random) -> Changes:
    gone, one, other = _uavs(chance)
    way = chance.choice(({"loss": 0.3}, {"latency_s": 0.4}, {"loss": 0.1, "burst": 4.0}))
    impaired = (
        Blow(
            when=Moment(step=Step.DETECTED, stored=False),
            kind="vehicle",
            options={"kind": "impair", "system_id": uav, "up": way, "down": way, "for_s": 20.0},
        )
        for uav in (one, other)
    )
    blows = (_kill(_in_flight(chance, 1.0, 15.0), gone), *impaired)
    return {**_RECOVERY, "autopilots": _mostly_ardupilot(chance), "blows": blows}


@_aim
def _a_loss_far_from_home(chance: random.Random) -> Changes:
    one, _, _ = _uavs(chance)
    when, options = _in_flight(chance, 25.0, 50.0), {"kind": chance.choice(("kill", "mute")), "system_id": one}
    return {**_RECOVERY, "blows": (Blow(when=when, kind="vehicle", options=options),)}


@_aim
def _ends_as_asked_for(chance: random.Random) -> Changes:
    at_end, autopilots = chance.choice(
        ((OnEnd.RETURN, (Autopilot.PX4,)), (OnEnd.RETURN, (Autopilot.PX4,)), (OnEnd.HOLD, _mostly_ardupilot(chance)))
    )
    return {**_RECOVERY, "slots": 8, "at_end": at_end, "autopilots": autopilots, "loss": 0.1, "blows": ()}


@_aim
def _a_loss_on_the_way_of_others(chance: random.Random) -> Changes:
    one, _, _ = _uavs(chance)
    when = _in_flight(chance, 22.0, 38.0)
    mute = Blow(when=when, kind="vehicle", options={"kind": chance.choice(("kill", "mute")), "system_id": one})
    return {**_RECOVERY, "side_by_side": True, "blows": (mute,)}


@_aim
def _an_end_that_is_told_late(chance: random.Random) -> Changes:
    slots = 8
    before_s, after_s = _seconds(chance, 1.0, 2.0), _seconds(chance, 2.0, 2.8)
    when = _flying(round(slots * SLOT_S - before_s, 2))
    late = {"kind": "withhold", "message": "MISSION_CURRENT", "for_s": round(before_s + after_s, 2)}
    blows = (Blow(when=when, kind="vehicle", options={**late, "system_id": uav}) for uav in range(1, UAVS + 1))
    ends = {"at_end": OnEnd.RETURN, "autopilots": (Autopilot.PX4,)}
    return {**_RECOVERY, **ends, "slots": slots, "gust_mps": 0.0, "blows": tuple(blows)}


@_aim
def _a_loss_whose_way_home_others_need(chance: random.Random) -> Changes:
    options = {"kind": chance.choice(("kill", "mute")), "system_id": 1}
    gone = Blow(when=_in_flight(chance, 22.0, 34.0), kind="vehicle", options=options)
    return {**_RECOVERY, "along_a_way_home": True, "rally": chance.random() >= 0.5, "blows": (gone,)}


LATER = ("a_loss_on_the_way_of_others",)
"""Aims that were added later, for some of the odd seeds: those of the even ones stay as they are."""
NEWEST = ("an_end_that_is_told_late", "a_loss_whose_way_home_others_need")
"""Aims for other odd seeds, from `NEWEST_FROM` on: lower ones stay as they are."""
NEWEST_FROM = 1500
_LATER_EVERY, _LATER_REST, _NEWEST_REST = 8, 7, 3
_FIRST = [name for name in AIMS if name not in (*LATER, *NEWEST)]


# -- parts -------------------------------------------------------------------------------------------------------------


def _mostly_ardupilot(chance: random.Random) -> tuple[Autopilot, ...]:
    return chance.choice(((Autopilot.ARDUPILOT,), (Autopilot.ARDUPILOT,), (Autopilot.ARDUPILOT, Autopilot.PX4)))


def _uavs(chance: random.Random) -> list[int]:
    return chance.sample(range(1, UAVS + 1), UAVS)


def _seconds(chance: random.Random, least_s: float, most_s: float) -> float:
    return round(chance.uniform(least_s, most_s), 2)


def _flying(after_s: float) -> Moment:
    return Moment(state=State.FLYING, after_s=after_s)


def _in_flight(chance: random.Random, least_s: float, most_s: float) -> Moment:
    return _flying(_seconds(chance, least_s, most_s))


def _after(when: Moment, seconds: float) -> Moment:
    return when.model_copy(update={"after_s": round(when.after_s + seconds, 2)})


def _kill(when: Moment, system_id: int) -> Blow:
    return Blow(when=when, kind="vehicle", options={"kind": "kill", "system_id": system_id})


def _early_kill(chance: random.Random) -> Blow:
    return _kill(_in_flight(chance, 1.0, 12.0), chance.randint(1, UAVS))


def _human(when: Moment, system_id: int) -> Blow:
    options = {"kind": "mode_change", "system_id": system_id, "mode": "POSITION"}
    return Blow(when=when, kind="vehicle", options=options)


def _gone(chance: random.Random, when: Moment, system_id: int) -> Blow:
    if chance.random() < 0.3:
        return _human(when, system_id)
    kind = chance.choice(("kill", "kill", "motor_failure"))
    return Blow(when=when, kind="vehicle", options={"kind": kind, "system_id": system_id})


def _killed_service(chance: random.Random, when: Moment) -> Blow:
    return Blow(when=when, kind="kill_service", options={"down_s": chance.choice((0.2, 1.0, 3.0))})
