"""Whether what users get is so far off what plans promise that a new plan is worth making. Pure.

With a hysteresis: after a replan for this reason there is another one only once the difference has been below half
the limit meanwhile, or after a number of slots that doubles each time. So a difference that no plan mends, as that of a
base station that serves no user, does not lead to one replan after the other.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product

OVER_SLOTS = 2
"""Rates of so many of the last slots are compared."""
LEAST_MEASURED = 0.5
"""Share of the promised rates whose users must have been measured."""
PAUSE_SLOTS = 2
"""The first new plan may know little of what has changed: the second one may follow soon."""


@dataclass
class RatesWatch:
    """Decides when to replan. share: the difference that is too much, as a share of the promised rates; 0 is never."""

    share: float
    armed: bool = True
    pause_slots: int = PAUSE_SLOTS
    again_at_slot: int = 0

    def is_off(self, slot: int, difference: float | None) -> bool:
        """Return whether to replan as `slot` begins, given the difference over the slots before (None: unknown)."""
        if self.share <= 0.0 or difference is None:
            return False
        if difference < self.share / 2:
            self.armed, self.pause_slots = True, PAUSE_SLOTS
        if difference <= self.share or not (self.armed or slot >= self.again_at_slot):
            return False
        if not self.armed:
            self.pause_slots *= 2
        self.armed, self.again_at_slot = False, slot + self.pause_slots
        return True


def difference(
    promised_bps: Mapping[str, Sequence[float | None]],
    measured_bps: Callable[[str, int], float | None],
    slots: Iterable[int],
    first_slot: int = 0,
) -> float | None:
    """Return by what share of the promised rates the measured ones differ in sum, over some slots of the operation.

    promised_bps: what the plans in force give each user in each slot where their UAVs really were, by their channel;
    None where that is not known, from `first_slot` on. measured_bps: returns what a user was measured to get in a slot,
    None where it was not. Returns None where too few users were measured.
    """
    all_bps = seen_promised_bps = seen_bps = 0.0
    for user, slot in product(promised_bps, slots):
        promised, measured = promised_bps[user][slot - first_slot] or 0.0, measured_bps(user, slot)
        all_bps += promised
        if measured is not None:
            seen_promised_bps += promised
            seen_bps += measured
    if all_bps <= 0.0 or seen_promised_bps < LEAST_MEASURED * all_bps:
        return None
    return abs(seen_bps - seen_promised_bps) / seen_promised_bps
