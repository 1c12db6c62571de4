"""What an invariant is, and when it is looked at.

`meanwhile`: every half second of fleet time. `at_end`: when the operation is over and the service has stopped.
`afterwards`: when its ground is gone too. Each yields what is broken, nothing if it holds.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

from skyfolio.api.lab.torture.watch import Seen

Check = Callable[[Seen], Iterator[str]]
MEANWHILE: dict[str, Check] = {}
AT_END: dict[str, Check] = {}
AFTERWARDS: dict[str, Check] = {}


def meanwhile(check: Check) -> Check:
    """Add an invariant that must hold all the time."""
    return _added(MEANWHILE, check)


def at_end(check: Check) -> Check:
    """Add an invariant that must hold when all is over."""
    return _added(AT_END, check)


def afterwards(check: Check) -> Check:
    """Add an invariant that must hold when nothing of a drill is left."""
    return _added(AFTERWARDS, check)


def _added(checks: dict[str, Check], check: Check) -> Check:
    checks[check.__name__.removeprefix("_").replace("_", " ")] = check
    return check


def look(seen: Seen, checks: dict[str, Check]) -> None:
    """Note which of these invariants are broken now, by what is seen of each operation."""
    for one in seen.each:
        for name, check in checks.items():
            for detail in check(one):
                one.break_once(name, detail)
