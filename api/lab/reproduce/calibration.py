"""What the letter omits, varied all at once: every combination flown on a few layouts.

`fit.py` says which combinations match the letter's numbers, and which the numbers cannot tell apart.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, TypeAlias

import numpy as np

from skyfolio.api.lab.reproduce.batch import Runs
from skyfolio.api.lab.reproduce.courses import (
    BASELINE_1,
    COMPARED,
    FAILED,
    READINGS,
    SR_MAX,
    Choices,
    Flown,
    Job,
    Knows,
    Scheme,
    Split,
    compute,
    pro_alg,
)
from skyfolio.api.lab.reproduce.fit import TARGETS, Setting, Table, fitted
from skyfolio.planner.scenario import Fading

NOISE_DBM = (-80.0, -60.0, -50.0)
RADIUS_M: tuple[float | None, ...] = (60.0, 75.0, 90.0, 105.0, 120.0, None)
CHANNELS: tuple[tuple[Fading, Knows], ...] = (
    ("mean", "draw"),
    ("sampled", "draw"),
    ("sampled", "expectation"),
    ("sampled", "statistics"),
    ("held", "draw"),
    ("held", "statistics"),
)
Draws: TypeAlias = Mapping[Fading, Sequence[int]]
DRAWS: Draws = {"mean": (1,), "sampled": (1, 2, 4, 8), "held": (1, 2, 4)}
"""How many draws are averaged: the first so many of those that are flown."""
USERS_PER_UAV: tuple[Split, ...] = ("3, 3, 3", "4, 3, 2", "drawn")
UNITS = {"1/(kbit/s)": pro_alg("sum", -10.0), "1/(Mbit/s)": pro_alg("sum", -0.01)}
"""What the letter's mu = -10 is here, by the unit it may have had."""
REFINED_NOISE_DBM = (-80.0, -60.0)
REFINED_RADIUS_M = (80.0, 90.0, 100.0, 110.0)
REFINED_DRAWS = (1, 2, 4, 8, 16, 24)
REFINED_LAYOUTS = 8
FIRST_REFINED = 300
FIRST_LAYOUT = 200
"""Calibration has layouts of its own: none of those on which the claims are judged."""


@dataclass(frozen=True)
class Cell:
    """The courses of one combination of noise, radius and channel: scheme -> layout -> all draws and losses."""

    choices: Choices
    flown: dict[str, list[Flown]]


def grid() -> list[Choices]:
    """Return every combination of noise, radius and channel, with as many draws as are averaged at most."""
    return [
        Choices(noise_dbm=noise, user_radius_m=radius, split=split, fading=fading, knows=knows, draws=DRAWS[fading][-1])
        for noise, radius, split, (fading, knows) in product(NOISE_DBM, RADIUS_M, USERS_PER_UAV, CHANNELS)
        if radius is not None or split == "drawn"
    ]


def calibrate(batch: Runs, layouts: int) -> dict[str, Any]:
    """Fly the grid on so many layouts, and the neighbourhood of its best fit on REFINED_LAYOUTS others.

    Plain JSON data, each as `fit.fitted` gives it: layouts differ by more than settings do, and few of them flatter
    whichever setting suits them.
    """
    coarse = _flown(batch, grid(), DRAWS, FIRST_LAYOUT, layouts)
    refined = refine(batch)
    return {**coarse, "refined": refined, "core_seconds": round(batch.core_seconds, 1)}


def refine(batch: Runs) -> dict[str, Any]:
    """Fit the neighbourhood of the grid's best fit, on layouts that had no part in finding it."""
    near = [
        Choices(noise_dbm=noise, user_radius_m=radius, split=split, draws=REFINED_DRAWS[-1])
        for noise, radius, split in product(REFINED_NOISE_DBM, REFINED_RADIUS_M, USERS_PER_UAV)
    ]
    return _flown(batch, near, {"sampled": REFINED_DRAWS}, FIRST_REFINED, REFINED_LAYOUTS)


def _flown(batch: Runs, all_choices: Sequence[Choices], draws: Draws, first: int, layouts: int) -> dict[str, Any]:
    seeds = range(first, first + layouts)
    schemes = [*COMPARED, *UNITS.values()]
    jobs = {
        choices: {
            scheme.name: [Job(replace(choices, layout_seed=seed), scheme) for seed in seeds] for scheme in schemes
        }
        for choices in all_choices
    }
    flown = batch.run(compute, [job for cell in jobs.values() for mine in cell.values() for job in mine])
    cells = [
        Cell(choices, {name: [flown[job] for job in mine] for name, mine in cell.items()})
        for choices, cell in jobs.items()
    ]
    return {"layouts": list(seeds), **fitted(tabulated(cells, draws))}


def tabulated(cells: Sequence[Cell], draws_of: Draws) -> Table:
    """Tabulate every setting there is in the cells, and the numbers it gives on each layout."""
    settings, rows = [], []
    for cell in cells:
        for draws in draws_of[cell.choices.fading]:
            measured = _measured(cell, draws)
            for lost, reading, unit in product((*FAILED, None), READINGS, UNITS):
                choices = replace(cell.choices, draws=draws)
                settings.append(Setting.of(choices, lost or "each in turn", reading.name, unit))
                rows.append(_numbers(measured, lost, reading, UNITS[unit]))
    return Table(settings, np.array(rows))


def _measured(cell: Cell, draws: int) -> dict[str, list[list[dict[str, float]]]]:
    """Return scheme -> layout -> lost UAV -> measures, of the mean over the first `draws` draws."""
    return {
        name: [[one.course(lost, slice(draws)).measures() for lost in range(len(FAILED))] for one in layouts]
        for name, layouts in cell.flown.items()
    }


def _numbers(
    measured: dict[str, list[list[dict[str, float]]]], lost: str | None, reading: Scheme, unit: Scheme
) -> list[list[float]]:
    """(layouts, targets), in the order of TARGETS."""
    names = {"SR-Max": SR_MAX, "Baseline 1": BASELINE_1, "Baseline 2": reading, "Pro-Alg": unit}
    which = range(len(FAILED)) if lost is None else [FAILED.index(lost)]
    columns = [
        [float(np.mean([layout[f][measure] for f in which])) for layout in measured[names[scheme].name]]
        for scheme, measure in TARGETS
    ]
    return [list(row) for row in zip(*columns, strict=True)]
