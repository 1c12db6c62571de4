"""Calibration of what the letter omits: the noise, user layout and fading that match most of its numbers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np

from skyfolio.api.lab.reproduce.batch import Batch
from skyfolio.api.lab.reproduce.courses import COMPARED, FAILED, READINGS, Choices, Course, Job, compute

TARGETS: Mapping[tuple[str, str], float] = {
    ("SR-Max", "period_1"): 128.8,
    ("Baseline 2", "period_1"): 128.8 / 1.1709,
    ("Baseline 1", "period_1"): 75.68,
    ("SR-Max", "jain"): 0.65,
    ("Baseline 1", "jain"): 0.876,
    ("Baseline 2", "variance"): 119.4,
}
"""The letter's numbers that do not depend on mu."""

NOISE_DBM = (-80.0, -62.5, -60.0, -57.5, -55.0, -52.5, -50.0)
RADIUS_M: tuple[float | None, ...] = (60.0, 75.0, 90.0, 105.0, 120.0, None)
FADING: tuple[Literal["mean", "sampled"], ...] = ("mean", "sampled")
LAYOUTS_TRIED = 40
MATCHED = 0.1
"""A number counts as matched within 10 %."""


def misfit(measured: Mapping[str, Mapping[str, float]]) -> tuple[int, float, str]:
    """Return how many targets are missed by more than `MATCHED`, the r.m.s. of all relative errors, and the reading.

    The reading of Baseline 2 is the one that fits better. The variance counts by its square root.
    """
    fits = []
    for reading in READINGS:
        errors = np.array([_error(measured, scheme, measure, reading.name) for scheme, measure in TARGETS])
        fits.append((int((np.abs(errors) > MATCHED).sum()), float(np.sqrt(np.mean(errors**2))), reading.name))
    return min(fits)


def _error(measured: Mapping[str, Mapping[str, float]], scheme: str, measure: str, reading: str) -> float:
    ratio = measured[reading if scheme == "Baseline 2" else scheme][measure] / TARGETS[scheme, measure]
    return float(np.sqrt(ratio) if measure == "variance" else ratio) - 1


def mean_measures(courses: Mapping[Job, Course], jobs: Iterable[Job]) -> dict[str, dict[str, float]]:
    """Return scheme -> measure -> mean over the jobs of that scheme."""
    measured: dict[str, list[dict[str, float]]] = {}
    for job in jobs:
        measured.setdefault(job.scheme.name, []).append(courses[job].measures())
    return {
        scheme: {key: float(np.mean([row[key] for row in rows])) for key in rows[0]}
        for scheme, rows in measured.items()
    }


def jobs_of(choices: Choices, layouts: Sequence[int]) -> list[Job]:
    """Return the jobs of the compared schemes on these layouts, with each UAV failing in turn."""
    return [
        Job(replace(choices, layout_seed=layout, fading_seed=layout), scheme, failed)
        for layout in layouts
        for scheme in COMPARED
        for failed in FAILED
    ]


def calibrate(batch: Batch, layouts: Sequence[int]) -> dict[str, Any]:
    """Search noise x radius x fading on the mean over `layouts`, then the layout that fits best there."""
    grid = [
        Choices(noise_dbm=noise, user_radius_m=radius, fading=fading, layout_seed=0)
        for noise in NOISE_DBM
        for radius in RADIUS_M
        for fading in FADING
    ]
    ranked = _ranked(batch, {choices: jobs_of(choices, layouts) for choices in grid})
    best = ranked[0][0]
    seeds = [replace(best, layout_seed=seed, fading_seed=seed) for seed in range(LAYOUTS_TRIED)]
    chosen = _ranked(batch, {choices: jobs_of(choices, [choices.layout_seed]) for choices in seeds})[0]
    return {
        "grid": [row for _, row in ranked],
        "best": {**_named(best), "layout_seed": chosen[0].layout_seed},
        "at_best": chosen[1],
    }


def _ranked(batch: Batch, jobs: Mapping[Choices, list[Job]]) -> list[tuple[Choices, dict[str, Any]]]:
    """Return the choices from the best fit to the worst, each with its fit and what was measured."""
    courses = batch.run(compute, [job for each in jobs.values() for job in each])
    rows = []
    for choices, mine in jobs.items():
        measured = mean_measures(courses, mine)
        missed, error, reading = misfit(measured)
        row = {**_named(choices), "missed": missed, "error": error, "reading": reading, "measured": measured}
        rows.append((choices, row))
    return sorted(rows, key=lambda row: (row[1]["missed"], row[1]["error"]))


def _named(choices: Choices) -> dict[str, Any]:
    return {"noise_dbm": choices.noise_dbm, "user_radius_m": choices.user_radius_m, "fading": choices.fading}
