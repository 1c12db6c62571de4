"""The rules by which a claim is judged: size and noise apart.

A number is compared by its mean over all cases. Noise is the confidence interval of that mean over layouts and draws;
spread, how far single cases lie from it. The letter shows one case or an average of unknown kind, so a number of its
that is an ordinary case here, and near the mean, counts as reproduced. Where another verdict lies inside the interval
the claim is open: noise, and not size, would decide it.
"""

from __future__ import annotations

from enum import StrEnum
from math import ceil

import numpy as np
from pydantic import BaseModel

from skyfolio.api.lab.reproduce.estimates import Estimate, Measured, Statistic

NEAR, IN_REGIME = 0.1, 0.25
"""Reproduced: within 10 % of the letter's, or within 25 % and one spread over cases."""
MOST_CASES = 0.8
EPSILON = 1e-6
"""A difference must be above this to be one: kbit/s, or whatever the claim compares."""


class Verdict(StrEnum):
    """As said in the write-up."""

    REPRODUCED = "reproduced"
    TREND_ONLY = "trend only"
    OPEN = "open"
    NOT = "not reproducible"


class Judged(BaseModel):
    """One claim: the letter's number (None for a trend), ours, verdict and reason.

    half, draws_half: half the 95 % confidence interval, and the part of it that draws alone give. spread: over cases.
    kind, reading: of which utility and which reading of Baseline 2 it is said, where it depends on one. settles: what
    would settle a claim that is not reproduced.
    """

    figure: str
    claim: str
    unit: str = ""
    kind: str | None = None
    reading: str | None = None
    paper: float | None = None
    ours: float
    half: float | None = None
    draws_half: float | None = None
    spread: float | None = None
    verdict: Verdict
    reason: str
    settles: str = ""


def number(
    figure: str,
    claim: str,
    unit: str,
    paper: float,
    measured: Measured,
    of: Statistic,
    *,
    kind: str | None = None,
    reading: str | None = None,
) -> Judged:
    """Judge a number of the letter's."""
    found = measured.estimate(of)
    verdict, reason, settles = compared(found, paper)
    return Judged(
        figure=figure,
        claim=claim,
        unit=unit,
        kind=kind,
        reading=reading,
        paper=paper,
        ours=found.value,
        half=found.half,
        draws_half=found.draws_half,
        spread=found.spread,
        verdict=verdict,
        reason=reason,
        settles=settles,
    )


def compared(found: Estimate, paper: float) -> tuple[Verdict, str, str]:
    """Return the verdict on a number, its reason, and what would settle it."""
    off, noise = abs(found.value - paper) / abs(paper), found.half / abs(paper)
    nearest = max(off - noise, 0.0)
    ordinary = abs(found.value - paper) <= found.spread and off <= IN_REGIME
    says = f"{off:.0%} off" + (", an ordinary case" if ordinary else "")
    if nearest > IN_REGIME:
        return Verdict.NOT, f"{says}, and {nearest:.0%} at the near end of the interval", ""
    if noise <= IN_REGIME and (off <= NEAR or ordinary):
        return Verdict.REPRODUCED, says, ""
    if noise <= IN_REGIME and off <= IN_REGIME and nearest > NEAR:
        return Verdict.TREND_ONLY, f"{says}: same regime, and not by noise", ""
    return Verdict.OPEN, f"{says}, but the interval is ±{noise:.0%} of the letter's", _more(found, off, noise)


def _more(found: Estimate, off: float, noise: float) -> str:
    """Return how many layouts would decide, if the mean stays where it is and the interval shrinks as it should."""
    if off <= IN_REGIME < noise:
        needed, what = IN_REGIME, "the interval would be narrow enough to say"
    else:
        line = NEAR if off <= IN_REGIME else IN_REGIME
        needed, what = max(abs(off - line), 0.01), f"the interval would clear the {line:.0%} line"
    return f"{ceil(len(found.cases) * (noise / needed) ** 2)} layouts: {what}"


def trend(
    figure: str,
    claim: str,
    measured: Measured,
    of: Statistic,
    *,
    change: Statistic | None = None,
    kind: str | None = None,
    reading: str | None = None,
) -> Judged:
    """Judge a trend: it holds where `of` is positive. `change`, by default `of`, is what must differ from zero."""
    holds = measured.estimate(of)
    size = holds if change is None else measured.estimate(change)
    verdict, reason, settles = held(holds, size)
    return Judged(
        figure=figure,
        claim=claim,
        unit="share of cases",
        kind=kind,
        reading=reading,
        ours=float((holds.cases > EPSILON).mean()),
        verdict=verdict,
        reason=reason,
        settles=settles,
    )


def held(holds: Estimate, size: Estimate) -> tuple[Verdict, str, str]:
    """Return the verdict on a trend, its reason, and what would settle it."""
    share = float(np.mean(holds.cases > EPSILON))
    on_mean = holds.value > EPSILON and size.value > 0
    reason = (
        f"holds {'' if on_mean else 'not '}on average, and in {share:.0%} of the cases; "
        f"change {size.value:.3g} ± {size.half:.2g}"
    )
    if abs(size.value) <= size.half and size.half > EPSILON:
        n = ceil(len(size.cases) * (size.half / max(abs(size.value), EPSILON)) ** 2)
        return Verdict.OPEN, reason, f"{n} layouts: the change would differ from none"
    if not on_mean:
        return Verdict.NOT, reason, ""
    return (Verdict.REPRODUCED if share >= MOST_CASES else Verdict.TREND_ONLY), reason, ""
