"""Rates of a flight, kept while it is flown: every sample is evaluated once, when it is recorded.

When something about the past becomes known late (since when a UAV is lost, a plan in force earlier than assumed), the
slots that it affects are summed again, and no others. The work is done in pieces, because it runs on the event loop.
Of a flight without an end the newest slots are kept (`forget_before`).
"""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import inf, nextafter

import numpy as np

from skyfolio.api.flights.rates import InForce, Sample, rates_by_sample
from skyfolio.api.flights.track import Seen, Track
from skyfolio.planner.arrays import Array

AT_ONCE = 8
"""Samples that are evaluated before the event loop may do something else: some milliseconds for a large fleet."""


@dataclass
class _Slot:
    """Which samples of the track belong to one slot, and the sum over the first `done` of them: (K,) bit/s."""

    total: Array
    samples: list[int] = field(default_factory=list)
    done: int = 0


class FlownRates:
    """Mean rate of each user in each slot of an operation, as `rates_by_slot` has it, kept up to date in pieces.

    track: where every UAV was; it grows.
    """

    def __init__(self, track: Track, user_ids: Sequence[str], n_slots: int, slot_s: float) -> None:
        self._track, self._known = track, 0
        self._slot_s, self._n_slots = slot_s, n_slots
        self.first_slot = 0
        """The slot of the operation with which the rows of `by_user` begin."""
        self._by_user: dict[str, list[float | None]] = {user: [None] * n_slots for user in user_ids}
        self._slots: dict[int, _Slot] = {}
        self._behind: set[int] = set()
        self._newest: InForce | None = None
        self._lost: dict[str, float] = {}

    @property
    def by_user(self) -> Mapping[str, Sequence[float | None]]:
        """Return the bit/s of each user in each slot from `first_slot` on; None where no sample was evaluated."""
        return self._by_user

    def cover(self, n_slots: int) -> None:
        """Have rates of so many slots of the operation from now on, which is longer than it was."""
        more = n_slots - self._n_slots
        if more > 0:
            self._n_slots = n_slots
            for row in self._by_user.values():
                row.extend([None] * more)

    def forget_before(self, slot: int) -> None:
        """Keep no rates of slots before this one of the operation; nor are they summed again, whatever becomes known.

        Samples of the track that belong to them may be forgotten from then on.
        """
        count = slot - self.first_slot
        if count <= 0:
            return
        self.first_slot = slot
        for row in self._by_user.values():
            del row[:count]
        self._slots = {number: kept for number, kept in self._slots.items() if number >= slot}
        self._behind = {number for number in self._behind if number >= slot}

    def is_behind(self, timeline: Sequence[InForce], lost: Mapping[str, float]) -> bool:
        """Return whether samples wait for `work`; parameters as there."""
        self._learn(timeline, lost)
        return bool(self._behind)

    def work(self, timeline: Sequence[InForce], lost: Mapping[str, float], most: int = AT_ONCE) -> None:
        """Evaluate up to `most` samples that wait, those of the newest slot first.

        lost: since when each UAV serves no user, fleet seconds. A slot that is summed again keeps its old rates until
        all its samples are in the new sum.
        """
        self._learn(timeline, lost)
        while self._behind and most > 0:
            number = max(self._behind)
            slot = self._slots[number]
            indices = slot.samples[slot.done : slot.done + most]
            rates = rates_by_sample(timeline, [_sample(self._track.numbered(index), lost) for index in indices])
            slot.total += rates.sum(axis=0)
            slot.done += len(indices)
            most -= len(indices)
            if slot.done == len(slot.samples):
                self._behind.discard(number)
                for row, rate in zip(self._by_user.values(), (slot.total / slot.done).tolist(), strict=True):
                    row[number - self.first_slot] = rate

    async def settle(self, timeline: Sequence[InForce], lost: Mapping[str, float]) -> None:
        """Evaluate every sample that waits, and let other tasks run meanwhile; parameters as of `work`."""
        while self.is_behind(timeline, lost):
            self.work(timeline, lost, AT_ONCE)
            await asyncio.sleep(0)

    def _learn(self, timeline: Sequence[InForce], lost: Mapping[str, float]) -> None:
        """Take in new samples, and find the old ones whose rates newly known plans and losses change."""
        for index in range(max(self._known, self._track.first), self._track.end):
            self._take_in(index, self._at_s(index))
        self._known = self._track.end
        for entry in self._new_of(timeline):
            self._forget(nextafter(entry.from_s, -inf), inf)
        self._newest = timeline[-1]
        if lost != self._lost:
            for uav in lost.keys() | self._lost.keys():
                before, after = self._lost.get(uav, inf), lost.get(uav, inf)
                if before != after:
                    self._forget(min(before, after), max(before, after))
            self._lost = dict(lost)

    def _new_of(self, timeline: Sequence[InForce]) -> list[InForce]:
        """Return the entries that were added since the newest one that is known; older ones may be gone."""
        new: list[InForce] = []
        for entry in reversed(timeline):
            if entry is self._newest:
                break
            new.append(entry)
        return new

    def _take_in(self, index: int, at_s: float) -> None:
        number = int(at_s // self._slot_s)
        if not self.first_slot <= number < self._n_slots or at_s >= self._n_slots * self._slot_s:
            return
        if number not in self._slots:
            self._slots[number] = _Slot(np.zeros(len(self._by_user)))
        self._slots[number].samples.append(index)
        self._behind.add(number)

    def _forget(self, after_s: float, to_s: float) -> None:
        """Sum slots again that have an evaluated sample with `after_s` < time <= `to_s`."""
        for number, slot in self._slots.items():
            if (number + 1) * self._slot_s < after_s or number * self._slot_s > to_s:
                continue
            if any(after_s < self._at_s(index) <= to_s for index in slot.samples[: slot.done]):
                slot.done, slot.total = 0, np.zeros_like(slot.total)
                self._behind.add(number)

    def _at_s(self, index: int) -> float:
        return self._track.at_s(index - self._track.first)


def _sample(seen: Seen, lost: Mapping[str, float]) -> Sample:
    at_s, positions_m = seen
    return Sample(at_s, positions_m, frozenset(uav for uav in positions_m if at_s <= lost.get(uav, inf)))
