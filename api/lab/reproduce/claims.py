"""What the letter says, and whether it is so here. Verdicts follow from rules, not from taste."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from skyfolio.api.lab.reproduce.courses import BASELINE_1, READINGS, SR_MAX, pro_alg
from skyfolio.planner.arrays import Array

Measured = Mapping[str, Mapping[str, Array]]
"""scheme name -> measure -> one value for each case (layout x failing UAV), in the same order of cases."""

MUS = (-0.003, -0.01, -0.03, -0.1, -0.3, -1.0, -3.0, -10.0)
KINDS = ("sum", "per_user", "pooled")
NEAR, IN_REGIME = 0.1, 0.25
"""Reproduced: within 10 % of the letter's, or within 25 % and one spread; within either of those, in trend."""
MOST_CASES = 0.8
RISE_KBPS = 1e-6


class Verdict(StrEnum):
    """As said in the write-up."""

    REPRODUCED = "reproduced"
    TREND_ONLY = "trend only"
    NOT = "not reproducible"


class Judged(BaseModel):
    """One claim: the letter's number (None for a trend), ours as mean and spread over cases, verdict and reason."""

    figure: str
    claim: str
    unit: str = ""
    paper: float | None = None
    ours: float
    spread: float | None = None
    verdict: Verdict
    reason: str


def judged(measured: Measured, converged: Mapping[str, Sequence[float]]) -> list[Judged]:
    """Return all claims in the order of the letter's figures."""
    return [*_convergence(converged), *_rates(measured), *_after_the_loss(measured), *_tuning(measured)]


def _number(figure: str, claim: str, unit: str, paper: float, values: Array) -> Judged:
    ours, spread = float(values.mean()), float(values.std())
    off = abs(ours - paper)
    share = off / abs(paper)
    if share <= NEAR or (off <= spread and share <= IN_REGIME):
        verdict, reason = Verdict.REPRODUCED, f"{share:.0%} off" + (", within one spread" if off <= spread else "")
    elif off <= spread or share <= IN_REGIME:
        where = "within one spread" if off <= spread else "same regime"
        verdict, reason = Verdict.TREND_ONLY, f"{where}, but {share:.0%} off"
    else:
        verdict, reason = Verdict.NOT, f"{share:.0%} off, and beyond one spread"
    return Judged(
        figure=figure, claim=claim, unit=unit, paper=paper, ours=ours, spread=spread, verdict=verdict, reason=reason
    )


def _trend(figure: str, claim: str, holds: NDArray[np.bool_], on_mean: bool) -> Judged:
    """Judge a claim by the share of cases in which it holds.

    holds: one truth value for each case.
    """
    share = float(np.mean(holds))
    in_most = Verdict.REPRODUCED if share >= MOST_CASES else Verdict.TREND_ONLY
    verdict = in_most if on_mean else Verdict.NOT
    reason = f"holds {'' if on_mean else 'not '}on average, and in {share:.0%} of the cases"
    return Judged(figure=figure, claim=claim, unit="share of cases", ours=share, verdict=verdict, reason=reason)


def _convergence(converged: Mapping[str, Sequence[float]]) -> Iterator[Judged]:
    """converged: for each mu, the utility after each iteration of Algorithm 1."""
    shares = np.array(
        [(history[2] - history[0]) / max(history[-1] - history[0], 1e-9) for history in converged.values()]
    )
    within = np.array([history[2] >= history[-1] - 0.01 * abs(history[-1]) for history in converged.values()])
    yield _trend("2", "converged (to 1 %) within three iterations", within, bool(within.mean() > 0.5))
    yield Judged(
        figure="2",
        claim="share of the gain after the first iteration that the third has reached",
        ours=float(shares.mean()),
        spread=float(shares.std()),
        verdict=Verdict.REPRODUCED if shares.mean() >= 0.99 else Verdict.TREND_ONLY,
        reason="mean over the values of mu",
    )


def _rates(measured: Measured) -> Iterator[Judged]:
    sr_max, baseline_1 = (measured[scheme.name]["period_1"] for scheme in (SR_MAX, BASELINE_1))
    yield _number("3", "SR-Max, mean sum rate in period one", "kbit/s", 128.8, sr_max)
    yield _number("3", "Baseline 1, mean sum rate in period one", "kbit/s", 75.68, baseline_1)
    yield _number("3", "SR-Max over Baseline 1", "%", 70.19, 100 * (sr_max / baseline_1 - 1))
    for reading in READINGS:
        two = measured[reading.name]["period_1"]
        yield _number("3", f"{reading.name}, mean sum rate in period one", "kbit/s", 128.8 / 1.1709, two)
        yield _number("3", f"SR-Max over {reading.name}", "%", 17.09, 100 * (sr_max / two - 1))
        ordered = (sr_max > two) & (two > baseline_1)
        on_mean = bool(sr_max.mean() > two.mean() > baseline_1.mean())
        yield _trend("3", f"SR-Max > {reading.name} > Baseline 1", ordered, on_mean)


def _after_the_loss(measured: Measured) -> Iterator[Judged]:
    for scheme in (SR_MAX, *READINGS, BASELINE_1):
        got = measured[scheme.name]
        fall = got["before"] - got["at_loss"]
        yield _trend("3", f"{scheme.name} drops when the UAV fails", fall > 0, bool(fall.mean() > 0))
        rise = got["at_end"] - got["at_loss"]
        yield _trend("3", f"{scheme.name} recovers after it", rise > RISE_KBPS, bool(rise.mean() > RISE_KBPS))


def _tuning(measured: Measured) -> Iterator[Judged]:
    for reading in READINGS:
        variance = measured[reading.name]["variance"]
        yield _number("5a", f"{reading.name}, variance of the sum rate", "(kbit/s)²", 119.4, variance)
    for kind in KINDS:
        steadiest = measured[pro_alg(kind, MUS[-1]).name]["variance"]
        yield _number("5a", f"{kind}, variance at mu = -10", "(kbit/s)²", 48.97, steadiest)
        for reading in READINGS:
            ratio = 100 * steadiest / measured[reading.name]["variance"]
            yield _number("5a", f"{kind}, that variance over that of {reading.name}", "%", 41.01, ratio)
    for kind in KINDS:
        yield _along_mu("5a", f"{kind}: variance falls with |mu|", measured, kind, "variance", falling=True)
        yield _along_mu("5a", f"{kind}: sum rate falls with |mu|", measured, kind, "mean", falling=True)
    yield _number("5b", "SR-Max, Jain index", "", 0.65, measured[SR_MAX.name]["jain"])
    yield _number("5b", "Baseline 1, Jain index", "", 0.876, measured[BASELINE_1.name]["jain"])
    for kind in KINDS:
        yield _along_mu("5b", f"{kind}: Jain index grows with |mu|", measured, kind, "jain", falling=False)


def along_mu(measured: Measured, kind: str, measure: str) -> Array:
    """Return the measure over SR-Max (mu = 0) and then each mu, from weak to strong: (number of mu, cases)."""
    schemes = [SR_MAX.name, *(pro_alg(kind, mu).name for mu in MUS)]
    return np.array([measured[name][measure] for name in schemes])


def _along_mu(figure: str, claim: str, measured: Measured, kind: str, measure: str, *, falling: bool) -> Judged:
    """Judge a trend over mu: Spearman's rank correlation of the measure and |mu| must exceed 0.5."""
    curves = along_mu(measured, kind, measure) * (-1 if falling else 1)
    each = np.array([rank_agreement(curve) for curve in curves.T])
    return _trend(figure, claim, each > 0.5, rank_agreement(curves.mean(axis=1)) > 0.5)


def rank_agreement(curve: Array) -> float:
    """Spearman's rank correlation of a curve with its own order: 1 when it only rises. 0 for a constant curve."""
    rounded = np.round(curve, 6)
    if np.ptp(rounded) == 0:
        return 0.0
    from scipy.stats import spearmanr  # noqa: PLC0415 - half a second of import that only this needs

    return float(spearmanr(np.arange(len(rounded)), rounded).statistic)
