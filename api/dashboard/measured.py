"""Says which rates of an operation were measured, and which are computed from positions. Pure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence


def measured_share(rates_bps: Mapping[str, Sequence[float | None]], slots: Mapping[str, Sequence[int]]) -> float:
    """Return the share of the known rates, by user and slot, that were measured."""
    known = sum(rate is not None for row in rates_bps.values() for rate in row)
    measured = sum(
        row[slot] is not None for user, row in rates_bps.items() for slot in slots.get(user, ()) if slot < len(row)
    )
    return measured / known if known else 0.0


def source_words(rates_bps: Mapping[str, Sequence[float | None]], slots: Mapping[str, Sequence[int]]) -> str:
    """Return where rates come from, in words."""
    share = measured_share(rates_bps, slots)
    if share == 0.0:
        return "computed from positions"
    return "measured" if share == 1.0 else f"{share:.0%} measured, the rest computed from positions"
