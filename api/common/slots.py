"""Slots as text."""

from __future__ import annotations

from collections.abc import Sequence


def slot_ranges(slots: Sequence[int]) -> str:
    """Return ascending slots as text, runs shortened: '0-4, 7'."""
    runs: list[list[int]] = []
    for slot in slots:
        if runs and slot == runs[-1][-1] + 1:
            runs[-1].append(slot)
        else:
            runs.append([slot])
    return ", ".join(f"{run[0]}" if len(run) == 1 else f"{run[0]}-{run[-1]}" for run in runs)
