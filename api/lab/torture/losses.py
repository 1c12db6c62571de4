"""What must hold of losses: what is gone is lost, and no other vehicle is."""

from __future__ import annotations

from collections.abc import Iterator

from skyfolio.api.lab.torture.checks import at_end
from skyfolio.api.lab.torture.sightings import Noted
from skyfolio.api.lab.torture.watch import SETTLED_S, Seen

VERDICT_S = 12.0
"""Seconds from the death of a vehicle, or from when a human takes it, to the verdict."""
LEAST_SILENCE_S = 4.5
"""No UAV is lost that was heard more recently than this."""
_LEAVES_IT_OURS = frozenset({"pause", "decide", "readmit", "slow_disk", "full_disk", "dead_workers", "kill"})
"""Blows after which a vehicle that flies by our orders is known to."""
_BY_ORDER = frozenset({"ordered", "battery"})
"""Losses by order of the operator."""


@at_end
def _nobody_healthy_is_lost(seen: Seen) -> Iterator[str]:
    """Lose no vehicle on a link that loses a tenth: a false loss takes a good UAV from its users.

    Where more is lost, five HEARTBEATs in a row may be; what a blow has hit may be lost for that.
    """
    for event in filter(seen.is_own, seen.events):
        if event.kind != "uav_lost" or event.data["cause"] in _BY_ORDER:
            continue
        uav, cause, silent_s = event.data["uav_id"], event.data["cause"], event.data["silent_for_s"]
        system_id = seen.system_of(uav)
        if seen.drill.loss <= 0.1 and system_id not in seen.harmed and not _may_look_taken(seen, system_id, cause):
            yield f"{uav} was declared lost ({event.data['detail']}) and nothing had happened to it"
        if cause == "heartbeat_lost" and silent_s < LEAST_SILENCE_S:
            yield f"{uav} was declared lost after a silence of {silent_s:.1f} s"
    for uav, at_s, truly_silent_s in seen.silences:
        if truly_silent_s < LEAST_SILENCE_S:
            yield f"{uav} was declared lost at {at_s:.1f} s, and had been heard {truly_silent_s:.1f} s before"


def _may_look_taken(seen: Seen, system_id: int, cause: str) -> bool:
    """Return whether an order may have led to a loss; one to pause is no reason to see a human at work."""
    if system_id not in seen.ordered:
        return False
    return cause != "human_took_over" or any(one.blow.kind not in _LEAVES_IT_OURS for one in seen.struck)


@at_end
def _no_human_is_seen_where_none_is(seen: Seen) -> Iterator[str]:
    """Take no mission that ends, nor an order of our own, for a human at the controls: real ones would be missed.

    It is judged of vehicles to which nothing has happened, on a link that loses a tenth, once a service has settled:
    one that has just started does not know what the one before it has ordered.
    """
    for noted in seen.own_noted:
        event = noted.event
        if event.kind != "condition" or event.data["after"] != "human_took_over" or seen.drill.loss > 0.1:
            continue
        system_id = seen.system_of(event.data["uav_id"])
        settled = all(not start_s <= noted.at_s < start_s + SETTLED_S for start_s in seen.starts_s[1:])
        if settled and system_id not in seen.harmed and system_id not in seen.ordered:
            yield f"{event.data['uav_id']} is said at {noted.at_s:.1f} s to be flown by a human: {event.data['cause']}"


@at_end
def _who_is_gone_is_declared_lost(seen: Seen) -> Iterator[str]:
    """Notice that a vehicle is dead, or flown by a human: otherwise it is not replaced.

    Time counts as it does for recoveries. After the last slot there is nothing left to replace it for, and one that was
    lost before is replaced already.
    """
    for system_id, gone in seen.gone.items():
        uav = seen.uav_of(system_id)
        if uav not in seen.uavs:
            continue
        verdict = next((one for one in seen.noted if is_verdict(one, uav) and one.at_s >= gone.at_s), None)
        until = verdict or _first_end(seen, gone.at_s)
        if until is None or any(is_verdict(one, uav) and one.at_s < gone.at_s for one in seen.noted):
            continue
        took_s = until.at_s - gone.at_s - (until.excused_s - gone.excused_s)
        if took_s > VERDICT_S:
            yield f"{uav} was gone at {gone.at_s:.1f} s, and not declared lost within {took_s:.0f} s"


def is_verdict(noted: Noted, uav: str) -> bool:
    """Return whether an event declares a UAV lost."""
    return noted.event.kind == "uav_lost" and noted.event.data["uav_id"] == uav


def _first_end(seen: Seen, after_s: float) -> Noted | None:
    """Return the event with which the operation stopped flying slots after that; None if it had stopped before."""
    states = [noted for noted in seen.own_noted if noted.event.kind == "operation"]
    before = [noted.event.data["state"] for noted in states if noted.at_s <= after_s]
    if not before or before[-1] != "flying":
        return None
    return next((noted for noted in states if noted.at_s > after_s and noted.event.data["state"] != "flying"), None)
