"""The kinds of rules that a profile has about its autopilot's parameters, under any names its versions give them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from math import dist

from skyfolio.mavlink_bridge.findings import Facts, Finding, Level, Needs

Check = Callable[[float, Facts, Needs], list[Finding]]


@dataclass(frozen=True)
class Rule:
    """One rule about one parameter, under any of its names."""

    names: tuple[str, ...]
    check: Check = field(repr=False)


def one_of(names: tuple[str, ...], good: set[int], level: Level, should: str, why: str) -> Rule:
    """Return the rule that the parameter must have one of these values."""

    def check(value: float, facts: Facts, needs: Needs) -> list[Finding]:
        del facts, needs
        if int(value) in good:
            return []
        return [Finding(level=level, name=names[0], found=f"{value:g}", should=should, why=why)]

    return Rule(names, check)


def at_least(names: tuple[str, ...], least: Callable[[Needs], float], level: Level, why: str) -> Rule:
    """Return the rule that the parameter must be at least so much."""

    def check(value: float, facts: Facts, needs: Needs) -> list[Finding]:
        del facts
        if value >= least(needs):
            return []
        return [Finding(level=level, name=names[0], found=f"{value:g}", should=f"at least {least(needs):g}", why=why)]

    return Rule(names, check)


def at_most(names: tuple[str, ...], most: float, level: Level, why: str) -> Rule:
    """Return the rule that a vehicle guided by setpoints goes on for at most so many seconds without one."""

    def check(value: float, facts: Facts, needs: Needs) -> list[Finding]:
        del facts
        if value <= most or not needs.stream:
            return []
        return [Finding(level=level, name=names[0], found=f"{value:g}", should=f"at most {most:g}", why=why)]

    return Rule(names, check)


def limit(
    names: tuple[str, ...], needed_m: Callable[[Facts, Needs], float], why: str, *, enabled: str | None = None
) -> Rule:
    """Return the rule that the plan must stay inside of a limit of the vehicle's own, in metres (0: no limit).

    enabled: the parameter without which (or with a value of 0) the limit does not count.
    """

    def check(value: float, facts: Facts, needs: Needs) -> list[Finding]:
        off = enabled is not None and facts.parameters.get(enabled, 0) == 0
        if value <= 0 or off or value >= needed_m(facts, needs):
            return []
        should = f"0 (off) or at least {needed_m(facts, needs):.0f}"
        return [Finding(level=Level.BLOCKER, name=names[0], found=f"{value:g}", should=should, why=why)]

    return Rule(names, check)


def farthest_m(facts: Facts, needs: Needs) -> float:
    """Return how far from home the plan takes it, metres."""
    home = facts.home_m or needs.path_m[0]
    return max(dist(point, home) for point in needs.path_m)


def altitude_m(facts: Facts, needs: Needs) -> float:
    """Return how high above home the plan takes it, metres."""
    del facts
    return needs.altitude_m


def climb_mps(needs: Needs) -> float:
    """Return how fast the plan may have it climb and descend on its way, m/s."""
    return needs.climb_m / needs.slot_s * _ROUNDED


_ROUNDED = 1.0 - 1e-6
"""Parameters are stored as 32-bit floats."""


CLIMBS_LATE = "it climbs more slowly than planned, and would be lower over the ground than the plan has it"
SINKS_LATE = "it descends more slowly than planned, and would be higher than the plan has it"
BREACH = "the plan leaves it: the vehicle's fence would end the mission"
