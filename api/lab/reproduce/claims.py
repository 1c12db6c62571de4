"""What the letter says, and whether it is so here. Verdicts follow from rules (`verdicts.py`), not from taste."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from skyfolio.api.lab.reproduce.courses import BASELINE_1, BASELINE_2_FIXED, READINGS, SR_MAX, pro_alg
from skyfolio.api.lab.reproduce.estimates import Measured, Of, half
from skyfolio.api.lab.reproduce.verdicts import Judged, Verdict, number, trend
from skyfolio.planner.arrays import Array

MUS = (-0.01, -0.1, -0.3, -1.0, -10.0)
KINDS = ("sum", "per_user", "pooled")
STILL = (BASELINE_2_FIXED, BASELINE_1)
"""Schemes in which no UAV moves."""
RISES = 0.5
"""A curve over mu rises when its rank correlation with |mu| is above this."""


def judged(measured: Measured, converged: Mapping[str, Sequence[float]]) -> list[Judged]:
    """Return all claims in the order of the letter's figures."""
    return [*_convergence(converged), *_rates(measured), *_after_the_loss(measured), *_tuning(measured)]


def _convergence(converged: Mapping[str, Sequence[float]]) -> Iterator[Judged]:
    """converged: for each mu, the utility after each iteration of Algorithm 1."""
    shares = np.array(
        [(history[2] - history[0]) / max(history[-1] - history[0], 1e-9) for history in converged.values()]
    )
    within = np.array([history[2] >= history[-1] - 0.01 * abs(history[-1]) for history in converged.values()])
    yield Judged(
        figure="2",
        claim="converged (to 1 %) within three iterations",
        unit="share of the values of mu",
        ours=float(within.mean()),
        verdict=Verdict.REPRODUCED if within.mean() >= 0.8 else Verdict.TREND_ONLY,
        reason=f"on one draw, in {int(within.sum())} of {len(within)} values of mu",
        settles=""
        if within.mean() >= 0.8
        else "the letter's starting point and stopping rule, of which it says nothing",
    )
    n = len(shares)
    left_out = [float(np.delete(shares, index).mean()) for index in range(n)]
    done = shares.mean() >= 0.99
    yield Judged(
        figure="2",
        claim="share of the gain after the first iteration that the third has reached",
        ours=float(shares.mean()),
        half=half(left_out),
        verdict=Verdict.REPRODUCED if done else Verdict.TREND_ONLY,
        reason="mean over the values of mu" + ("" if done else ": still rising then"),
        settles="" if done else "the letter's starting point and stopping rule, of which it says nothing",
    )


def _rates(measured: Measured) -> Iterator[Judged]:
    one, simple = SR_MAX.name, BASELINE_1.name

    def over(of: Of, other: str) -> float:
        return 100 * (of(one, "period_1") / of(other, "period_1") - 1)

    yield number("3", "SR-Max, mean sum rate in period one", "kbit/s", 128.8, measured, lambda of: of(one, "period_1"))
    yield number(
        "3", "Baseline 1, mean sum rate in period one", "kbit/s", 75.68, measured, lambda of: of(simple, "period_1")
    )
    yield number("3", "SR-Max over Baseline 1", "%", 70.19, measured, lambda of: over(of, simple))
    for reading in (reading.name for reading in READINGS):

        def rate(of: Of, two: str = reading) -> float:
            return of(two, "period_1")

        def gain(of: Of, two: str = reading) -> float:
            return over(of, two)

        def least_step(of: Of, two: str = reading) -> float:
            rates = [of(name, "period_1") for name in (one, two, simple)]
            return min(rates[0] - rates[1], rates[1] - rates[2])

        yield number(
            "3", f"{reading}, mean sum rate in period one", "kbit/s", 128.8 / 1.1709, measured, rate, reading=reading
        )
        yield number("3", f"SR-Max over {reading}", "%", 17.09, measured, gain, reading=reading)
        yield trend("3", f"SR-Max > {reading} > Baseline 1", measured, least_step, reading=reading)


def _after_the_loss(measured: Measured) -> Iterator[Judged]:
    for scheme in (SR_MAX, *READINGS, BASELINE_1):
        name = scheme.name
        reading = name if scheme in READINGS else None

        def fall(of: Of, name: str = name) -> float:
            return of(name, "before") - of(name, "at_loss")

        def rise(of: Of, name: str = name) -> float:
            return of(name, "at_end") - of(name, "at_loss")

        def regained(of: Of, name: str = name) -> float:
            return of(name, "period_2") - of(name, "unadjusted")

        yield trend("3", f"{name} drops when the UAV fails", measured, fall, reading=reading)
        yield trend("3", f"{name} regains sum rate by adjusting", measured, regained, reading=reading)
        recovers = trend("3", f"{name} recovers after it", measured, rise, reading=reading)
        if scheme in STILL:  # whatever the draws happen to say: every slot after the loss has the same distribution
            reason = "by construction: no UAV moves, so every slot after the loss is worth the same on average"
            changed = {"verdict": Verdict.NOT, "reason": reason, "settles": "a reading in which this baseline flies"}
            recovers = recovers.model_copy(update=changed)
        yield recovers


def _tuning(measured: Measured) -> Iterator[Judged]:
    for reading in (reading.name for reading in READINGS):

        def variance(of: Of, name: str = reading) -> float:
            return of(name, "variance")

        claim = f"{reading}, variance of the sum rate"
        yield number("5a", claim, "(kbit/s)²", 119.4, measured, variance, reading=reading)
    for kind in KINDS:
        yield from _steadiest(measured, kind)
    for kind in KINDS:
        yield _along_mu("5a", f"{kind}: variance falls with |mu|", measured, kind, "variance", sign=-1)
        yield _along_mu("5a", f"{kind}: sum rate falls with |mu|", measured, kind, "mean", sign=-1)
    for name, printed in ((SR_MAX.name, 0.65), (BASELINE_1.name, 0.876)):

        def jain(of: Of, name: str = name) -> float:
            return of(name, "jain")

        yield number("5b", f"{name}, Jain index", "", printed, measured, jain)
    for kind in KINDS:
        yield _along_mu("5b", f"{kind}: Jain index grows with |mu|", measured, kind, "jain", sign=1)


def _steadiest(measured: Measured, kind: str) -> Iterator[Judged]:
    """Judge the variance at mu = -10, and over those of both readings of Baseline 2."""
    strong = pro_alg(kind, MUS[-1]).name
    yield number(
        "5a",
        f"{kind}, variance at mu = -10",
        "(kbit/s)²",
        48.97,
        measured,
        lambda of: of(strong, "variance"),
        kind=kind,
    )
    for reading in (reading.name for reading in READINGS):

        def ratio(of: Of, name: str = reading) -> float:
            return 100 * of(strong, "variance") / of(name, "variance")

        claim = f"{kind}, that variance over that of {reading}"
        yield number("5a", claim, "%", 41.01, measured, ratio, kind=kind, reading=reading)


def along_mu(kind: str) -> list[str]:
    """Return the schemes from mu = 0 (SR-Max) to the strongest mu."""
    return [SR_MAX.name, *(pro_alg(kind, mu).name for mu in MUS)]


def _along_mu(figure: str, claim: str, measured: Measured, kind: str, measure: str, *, sign: int) -> Judged:
    """Judge a trend over mu: ranks of the measure and of |mu| must agree; the noise is that of the whole change."""
    names = along_mu(kind)

    def agreement(of: Of) -> float:
        return rank_agreement(sign * np.array([of(name, measure) for name in names])) - RISES

    def change(of: Of) -> float:
        return sign * (of(names[-1], measure) - of(names[0], measure))

    return trend(figure, claim, measured, agreement, change=change, kind=kind)


def rank_agreement(curve: Array) -> float:
    """Spearman's rank correlation of a curve with its own order: 1 when it only rises. 0 for a constant curve."""
    rounded = np.round(curve, 6)
    if np.ptp(rounded) == 0:
        return 0.0
    from scipy.stats import spearmanr  # noqa: PLC0415 - half a second of import that only this needs

    return float(spearmanr(np.arange(len(rounded)), rounded).statistic)
