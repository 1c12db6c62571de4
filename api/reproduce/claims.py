"""What the letter says, and whether it is so here. Verdicts follow from rules, not from taste."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from api.reproduce.courses import BASELINE_1, BASELINE_2, SR_MAX, pro_alg

Array = NDArray[np.float64]
Measured = Mapping[str, Mapping[str, Array]]
"""scheme name -> measure -> one value for each case (layout x failing UAV), in the same order of cases."""

MUS = (-0.003, -0.01, -0.03, -0.1, -0.3, -1.0, -3.0, -10.0)
KINDS = ("sum", "per_user", "pooled")
NEAR, IN_REGIME = 0.05, 0.25
"""A number is reproduced within one spread or 5 % of the letter's, and in its regime within 25 %."""
MOST_CASES = 0.8


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
    """All claims in the order of the letter's figures."""
    return [*_convergence(converged), *_rates(measured), *_after_the_loss(measured), *_tuning(measured)]


def _number(figure: str, claim: str, unit: str, paper: float, values: Array) -> Judged:
    ours, spread = float(values.mean()), float(values.std())
    off = abs(ours - paper)
    if off <= max(spread, NEAR * abs(paper)):
        verdict, reason = Verdict.REPRODUCED, "within one spread over layouts and failing UAVs, or 5 %"
    elif off <= IN_REGIME * abs(paper):
        verdict, reason = Verdict.TREND_ONLY, f"same regime, {off / abs(paper):.0%} off: the letter omits its layout"
    else:
        verdict, reason = Verdict.NOT, f"{off / abs(paper):.0%} off under every setting that fits the other numbers"
    return Judged(
        figure=figure, claim=claim, unit=unit, paper=paper, ours=ours, spread=spread, verdict=verdict, reason=reason
    )


def _trend(figure: str, claim: str, holds: NDArray[np.bool_], on_mean: bool) -> Judged:
    """holds: one truth value for each case."""
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
    sr_max, one, two = (measured[scheme.name]["period_1"] for scheme in (SR_MAX, BASELINE_1, BASELINE_2))
    yield _number("3", "SR-Max, mean sum rate in period one", "kbit/s", 128.8, sr_max)
    yield _number("3", "Baseline 1, mean sum rate in period one", "kbit/s", 75.68, one)
    yield _number("3", "Baseline 2, mean sum rate in period one", "kbit/s", 128.8 / 1.1709, two)
    yield _number("3", "SR-Max over Baseline 1", "%", 70.19, 100 * (sr_max / one - 1))
    yield _number("3", "SR-Max over Baseline 2", "%", 17.09, 100 * (sr_max / two - 1))
    ordered = (sr_max > two) & (two > one)
    yield _trend("3", "SR-Max > Baseline 2 > Baseline 1", ordered, bool(sr_max.mean() > two.mean() > one.mean()))


def _after_the_loss(measured: Measured) -> Iterator[Judged]:
    for scheme in (SR_MAX, BASELINE_2, BASELINE_1):
        got = measured[scheme.name]
        drops = got["at_loss"] < got["before"]
        yield _trend(
            "3", f"{scheme.name} drops when the UAV fails", drops, bool((got["at_loss"] - got["before"]).mean() < 0)
        )
        recovers = got["at_end"] > got["at_loss"] + 1e-9
        yield _trend(
            "3", f"{scheme.name} recovers after it", recovers, bool((got["at_end"] - got["at_loss"]).mean() > 1e-6)
        )


def _tuning(measured: Measured) -> Iterator[Judged]:
    baseline = measured[BASELINE_2.name]["variance"]
    yield _number("5a", "Baseline 2, variance of the sum rate", "(kbit/s)²", 119.4, baseline)
    for kind in KINDS:
        steadiest = measured[pro_alg(kind, MUS[-1]).name]["variance"]
        yield _number("5a", f"{kind}, variance at mu = -10", "(kbit/s)²", 48.97, steadiest)
        yield _number("5a", f"{kind}, that variance over Baseline 2's", "%", 41.01, 100 * steadiest / baseline)
    for kind in KINDS:
        yield _along_mu("5a", f"{kind}: variance falls with |mu|", measured, kind, "variance", falling=True)
        yield _along_mu("5a", f"{kind}: sum rate falls with |mu|", measured, kind, "mean", falling=True)
    yield _number("5b", "SR-Max, Jain index", "", 0.65, measured[SR_MAX.name]["jain"])
    yield _number("5b", "Baseline 1, Jain index", "", 0.876, measured[BASELINE_1.name]["jain"])
    for kind in KINDS:
        yield _along_mu("5b", f"{kind}: Jain index grows with |mu|", measured, kind, "jain", falling=False)


def along_mu(measured: Measured, kind: str, measure: str) -> Array:
    """(number of mu, cases): the measure over SR-Max (mu = 0) and then each mu, from weak to strong."""
    schemes = [SR_MAX.name, *(pro_alg(kind, mu).name for mu in MUS)]
    return np.array([measured[name][measure] for name in schemes])


def _along_mu(figure: str, claim: str, measured: Measured, kind: str, measure: str, *, falling: bool) -> Judged:
    """A trend over mu holds when ranks of the measure and of |mu| agree: Spearman's coefficient beyond 0.5."""
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
