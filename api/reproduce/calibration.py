"""Finding what the letter omits: the noise, user layout and fading that match most of its numbers at once."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from api.reproduce.batch import Batch
from api.reproduce.courses import COMPARED, Choices, Course, Job, compute

TARGETS: Mapping[tuple[str, str], float] = {
    ("SR-Max", "period_1"): 128.8,
    ("Baseline 2", "period_1"): 128.8 / 1.1709,
    ("Baseline 1", "period_1"): 75.68,
    ("SR-Max", "jain"): 0.65,
    ("Baseline 1", "jain"): 0.876,
    ("Baseline 2", "variance"): 119.4,
}
"""The letter's numbers that do not depend on mu."""

NOISE_DBM = (-80.0, -60.0, -57.5, -55.0, -52.5, -50.0)
RADIUS_M: tuple[float | None, ...] = (60.0, 75.0, 90.0, 105.0, 120.0, None)
FADING = ("mean", "sampled")
FAILED = ("uav-1", "uav-2", "uav-3")


def misfit(measured: Mapping[str, Mapping[str, float]]) -> float:
    """Root mean square of the relative errors against the targets; the variance counts by its square root."""
    errors = []
    for (scheme, measure), target in TARGETS.items():
        ours = measured[scheme][measure]
        power = 0.5 if measure == "variance" else 1.0
        errors.append(ours**power / target**power - 1)
    return float(np.sqrt(np.mean(np.square(errors))))


def mean_measures(courses: Mapping[Job, Course], jobs: Iterable[Job]) -> dict[str, dict[str, float]]:
    """scheme -> measure -> mean over the jobs of that scheme."""
    found: dict[str, list[dict[str, float]]] = {}
    for job in jobs:
        found.setdefault(job.scheme.name, []).append(courses[job].measures())
    return {
        scheme: {key: float(np.mean([row[key] for row in rows])) for key in rows[0]} for scheme, rows in found.items()
    }


def jobs_of(choices: Choices, layouts: Sequence[int]) -> list[Job]:
    """The compared schemes on these layouts, with each UAV failing in turn."""
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
    jobs = {choices: jobs_of(choices, layouts) for choices in grid}
    courses = batch.run(compute, [job for each in jobs.values() for job in each])
    ranked = sorted((misfit(mean_measures(courses, jobs[choices])), index) for index, choices in enumerate(grid))
    best = grid[ranked[0][1]]
    by_layout = {layout: jobs_of(best, [layout]) for layout in range(40)}
    courses = batch.run(compute, [job for each in by_layout.values() for job in each])
    layout = min(by_layout, key=lambda one: misfit(mean_measures(courses, by_layout[one])))
    return {
        "grid": [
            {
                **_named(grid[index]),
                "misfit": fit,
                "measured": mean_measures(courses_of(batch, jobs[grid[index]]), jobs[grid[index]]),
            }
            for fit, index in ranked
        ],
        "best": {**_named(best), "layout_seed": layout},
        "misfit": misfit(mean_measures(courses, by_layout[layout])),
        "measured": mean_measures(courses, by_layout[layout]),
    }


def courses_of(batch: Batch, jobs: Iterable[Job]) -> dict[Job, Course]:
    """The courses of jobs that have been computed, from the batch's memory."""
    return batch.run(compute, jobs)


def _named(choices: Choices) -> dict[str, Any]:
    return {"noise_dbm": choices.noise_dbm, "user_radius_m": choices.user_radius_m, "fading": choices.fading}
