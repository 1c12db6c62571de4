"""The parts of the planner's benchmark: one section at one size under one utility, each in a process of its own.

A part is the unit that is run, timed and kept in the file of figures; a table of the report is made of many of them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

from skyfolio.api.lab.bench import bounding, cases, checked, peers, quality, terrain, windy
from skyfolio.api.lab.bench.effort import Effort
from skyfolio.api.lab.bench.instances import FLEETS, LETTER, Size, size_of, text_of
from skyfolio.planner.utilities import UTILITIES

Measure: TypeAlias = Callable[[Size, str, Effort], dict[str, Any]]


@dataclass(frozen=True, kw_only=True)
class Section:
    """One question to the planner, with the sizes and utilities that it is put to.

    timed: its figures are times, so that nothing else of this benchmark may share its core.
    """

    measure: Measure
    sizes: tuple[Size, ...]
    kinds: tuple[str, ...] = tuple(UTILITIES)
    timed: bool = False


@dataclass(frozen=True)
class Part:
    """A section at one size under one utility."""

    section: str
    size: Size
    kind: str

    @property
    def name(self) -> str:
        """As in the file of figures: `quality 10x100x50 sum`."""
        return f"{self.section} {text_of(self.size)} {self.kind}"

    def measure(self, effort: Effort) -> dict[str, Any]:
        """Return the figures, measured in this process."""
        return SECTIONS[self.section].measure(self.size, self.kind, effort)


def _checked(_size: Size, _kind: str, effort: Effort) -> dict[str, Any]:
    return checked.checked(range(1, 1 + effort.checked))


ALL_SIZES = (LETTER, *FLEETS)
MOST = (checked.MOST_UAVS, checked.MOST_USERS, checked.MOST_SLOTS)
SECTIONS = {
    "quality": Section(measure=quality.quality, sizes=FLEETS, timed=True),
    "fast": Section(measure=cases.fast, sizes=ALL_SIZES, kinds=cases.KINDS, timed=True),
    "reference": Section(measure=cases.reference, sizes=ALL_SIZES, kinds=cases.KINDS, timed=True),
    "ipopt": Section(measure=cases.ipopt, sizes=ALL_SIZES, kinds=cases.KINDS, timed=True),
    "ablation": Section(measure=cases.ablation, sizes=(LETTER,), kinds=cases.KINDS, timed=True),
    "users": Section(measure=cases.users, sizes=(LETTER,), kinds=cases.KINDS, timed=True),
    "channels": Section(measure=cases.channels, sizes=ALL_SIZES[:2], kinds=cases.KINDS, timed=True),
    "energy": Section(measure=windy.energy, sizes=ALL_SIZES, kinds=cases.KINDS, timed=True),
    "terrain": Section(measure=terrain.terrain, sizes=ALL_SIZES, kinds=cases.KINDS, timed=True),
    "disruption": Section(measure=quality.disruption, sizes=ALL_SIZES, timed=True),
    "bound": Section(measure=bounding.bound, sizes=FLEETS[:2], kinds=("sum",)),
    "budgets": Section(measure=quality.budgets, sizes=FLEETS),
    "peers": Section(measure=peers.on_first_layout, sizes=FLEETS[:2]),
    "proof": Section(measure=cases.proof, sizes=(LETTER,), kinds=cases.KINDS),
    "checked": Section(measure=_checked, sizes=(MOST,), kinds=("any",)),
}
"""By name, in the order in which they run: what matters most comes first."""


def chosen(
    effort: Effort, *, sections: Sequence[str] = (), sizes: Sequence[str] = (), kinds: Sequence[str] = ()
) -> list[Part]:
    """Return the parts of these sections, sizes and utilities; none given: all of them that the effort has.

    Raises ValueError for a name that there is not, and where nothing is left.
    """
    within = ALL_SIZES[: effort.sizes] if not sizes else tuple(size_of(text) for text in sizes)
    _require("section", sections, SECTIONS)
    _require("size", sizes, (text_of(size) for one in SECTIONS.values() for size in one.sizes))
    _require("utility", kinds, (kind for one in SECTIONS.values() for kind in one.kinds))
    found = [
        Part(name, size, kind)
        for name, section in SECTIONS.items()
        for size in section.sizes
        for kind in section.kinds
        if (not sections or name in sections)
        and _ends(Part(name, size, kind), effort)
        and (size in within or (size == MOST and not sizes))
        and (not kinds or kind in kinds)
    ]
    if not found:
        raise ValueError("no section has a part of this size and utility")
    return found


def _ends(part: Part, effort: Effort) -> bool:
    """Return whether a part ends in the time of such a run: yardsticks do on so many sizes, from the smallest."""
    within = effort.yardsticks.get((part.section, part.kind), len(ALL_SIZES))
    return part.size in (*ALL_SIZES[:within], MOST)


def _require(what: str, names: Sequence[str], known: Iterable[str]) -> None:
    there_are = list(dict.fromkeys(known))
    for name in names:
        if name not in there_are:
            raise ValueError(f"{what}: {name!r} must be one of {', '.join(there_are)}")
