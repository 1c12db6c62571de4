"""How well settings match the letter's numbers: a joint fit, numbers held out, choices that cannot be distinguished."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from skyfolio.api.lab.reproduce.courses import Choices
from skyfolio.planner.arrays import Array

TARGETS: Mapping[tuple[str, str], float] = {
    ("SR-Max", "period_1"): 128.8,
    ("Baseline 1", "period_1"): 75.68,
    ("Baseline 2", "period_1"): 128.8 / 1.1709,
    ("Baseline 2", "variance"): 119.4,
    ("Pro-Alg", "variance"): 48.97,
    ("SR-Max", "jain"): 0.65,
    ("Baseline 1", "jain"): 0.876,
}
"""Every number of the letter that is not another one's ratio. Pro-Alg is at its mu = -10, under `sum`, its eq. (9)."""
SPLITS: Mapping[str, Sequence[tuple[str, str]]] = {
    "the rates of period one": [target for target in TARGETS if target[1] == "period_1"],
    "variances and Jain indices": [target for target in TARGETS if target[1] != "period_1"],
}
"""Fit on these alone, judge on the rest."""
KNOWN = {"draw": "the draw", "expectation": "its distribution", "statistics": "its mean"}
RESAMPLES = 500
UNLIKELY = 0.05
"""A value that is the best fit in fewer than 5 % of the resamples is excluded."""


@dataclass(frozen=True, kw_only=True)
class Setting:
    """One value for everything the letter leaves open, in words."""

    noise: str
    users: str
    users_per_uav: str
    fading: str
    draws: str
    planners_know: str
    failing: str
    baseline_2: str
    unit_of_mu: str

    @classmethod
    def of(cls, choices: Choices, failing: str, reading: str, unit: str) -> Self:
        """Return these choices in words; what planners know of mean fading is all there is to know."""
        drawn = choices.fading != "mean"
        radius = choices.user_radius_m
        return cls(
            noise=f"{choices.noise_dbm:g} dBm",
            users="anywhere" if radius is None else f"within {radius:g} m",
            users_per_uav=choices.split if radius is not None else "drawn",
            fading={"mean": "mean", "sampled": "drawn per slot", "held": "drawn per link and held"}[choices.fading],
            draws=str(choices.draws) if drawn else "none",
            planners_know=KNOWN[choices.knows] if drawn else "all",
            failing=failing,
            baseline_2=reading.removeprefix("Baseline 2 (").removesuffix(")"),
            unit_of_mu=unit,
        )


@dataclass(frozen=True)
class Table:
    """settings: C of them; numbers: (C, L, T), what each gives on L layouts for the T targets, in their order."""

    settings: list[Setting]
    numbers: Array


def errors(means: Array) -> Array:
    """Relative errors of (..., T) numbers against the letter's; a variance counts by its square root."""
    ratio = means / np.array(list(TARGETS.values()))
    squared = np.array([measure == "variance" for _, measure in TARGETS])
    off: Array = np.where(squared, np.sqrt(ratio), ratio) - 1
    return off


def misfits(means: Array, targets: NDArray[np.bool_] | None = None) -> Array:
    """Root mean square of the relative errors over the targets fitted (all by default): (...,)."""
    off = errors(means) if targets is None else errors(means)[..., targets]
    rms: Array = np.sqrt((off**2).mean(axis=-1))
    return rms


def fitted(table: Table) -> dict[str, Any]:
    """Return the best settings, numbers held out, what each choice does alone, and which cannot be distinguished."""
    means = table.numbers.mean(axis=1)
    order = np.argsort(misfits(means), kind="stable")
    best = int(order[0])
    return {
        "settings": len(table.settings),
        "best": _row(table, means, best),
        "next": [_row(table, means, int(index)) for index in order[1:10]],
        "best_by_layout": misfits(table.numbers[best]).tolist(),
        "held_out": held_out(means),
        "splits": splits(table, means),
        "told_apart": told_apart(table),
        "alone": _alone(table, means, best),
    }


def _row(table: Table, means: Array, index: int) -> dict[str, Any]:
    return {
        "setting": asdict(table.settings[index]),
        "misfit": float(misfits(means[index])),
        "numbers": _named(means[index]),
    }


def _named(numbers: Array) -> dict[str, float]:
    return {_name(target): float(value) for target, value in zip(TARGETS, numbers, strict=True)}


def _name(target: tuple[str, str]) -> str:
    return f"{target[0]}, {target[1].replace('period_1', 'mean sum rate in period one')}"


def held_out(means: Array) -> list[dict[str, Any]]:
    """Each number predicted by the settings that fit all the others best."""
    rows = []
    for index, (target, printed) in enumerate(TARGETS.items()):
        rest = np.arange(len(TARGETS)) != index
        chosen = int(misfits(means, rest).argmin())
        predicted = means[chosen, index]
        off = float(errors(means[chosen])[index])
        rows.append({"number": _name(target), "letter": printed, "predicted": float(predicted), "off": off})
    return rows


def splits(table: Table, means: Array) -> list[dict[str, Any]]:
    """For each split: the settings that fit one part best, their misfit there and on the part they have not seen."""
    rows = []
    for name, part in SPLITS.items():
        inside = np.array([target in part for target in TARGETS])
        chosen = int(misfits(means, inside).argmin())
        rows.append(
            {
                "fitted_on": name,
                **_row(table, means, chosen),
                "misfit_inside": float(misfits(means[chosen], inside)),
                "misfit_outside": float(misfits(means[chosen], ~inside)),
            }
        )
    return rows


def told_apart(table: Table) -> dict[str, list[dict[str, Any]]]:
    """Return choice -> value -> the best misfit with it, and in what share of resamples it is the best fit.

    A resample weighs the layouts anew (Dirichlet, the Bayesian bootstrap), so that few layouts give a smooth answer.
    """
    rng = np.random.default_rng(0)
    weights = rng.dirichlet(np.ones(table.numbers.shape[1]), size=RESAMPLES)
    winners = np.array([int(misfits(np.einsum("l,clt->ct", weight, table.numbers)).argmin()) for weight in weights])
    errors_of_means = misfits(table.numbers.mean(axis=1))
    found: dict[str, list[dict[str, Any]]] = {}
    for choice in (field.name for field in fields(Setting)):
        values = np.array([getattr(setting, choice) for setting in table.settings])
        found[choice] = [
            {
                "value": str(value),
                "misfit": float(errors_of_means[values == value].min()),
                "best_in": float(np.mean(values[winners] == value)),
            }
            for value in dict.fromkeys(values.tolist())
        ]
    return found


def _alone(table: Table, means: Array, best: int) -> list[dict[str, Any]]:
    """Each choice varied alone, the others as in the best fit."""
    chosen = asdict(table.settings[best])
    rows = []
    for index, setting in enumerate(table.settings):
        differing = [name for name, value in asdict(setting).items() if value != chosen[name]]
        if len(differing) == 1 or (setting.fading == "mean" and set(differing) <= {"fading", "draws", "planners_know"}):
            name = "fading" if len(differing) > 1 else differing[0]
            rows.append({"choice": name, "value": getattr(setting, name), **_row(table, means, index)})
    return rows
