"""The whole reproduction: run the courses, judge the claims, collect every number that is drawn or written."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from skyfolio.api.lab.bench.measure import machine
from skyfolio.api.lab.reproduce import ablation, figures
from skyfolio.api.lab.reproduce.batch import Advance, Batch, silent
from skyfolio.api.lab.reproduce.claims import KINDS, MUS, Judged, along_mu, judged
from skyfolio.api.lab.reproduce.courses import (
    COMPARED,
    FAILED,
    Choices,
    Course,
    Job,
    Scheme,
    compute,
    pro_alg,
)
from skyfolio.planner import MaxIterations, Utility, plan
from skyfolio.planner.arrays import Array

Study = dict[str, Any]
FIGURES = ("2", "3", "5a", "5b", "all")
CONVERGENCE_MUS = (0.0, -0.01, -0.1, -1.0, -10.0)
SHOWN_MUS = (-0.03, -0.3, -10.0)
ITERATIONS = 8


@dataclass(frozen=True, kw_only=True)
class StudyConfig:
    """figure: one of FIGURES. layouts: how many user layouts, each with every UAV failing in turn."""

    figure: str = "all"
    layouts: int = 5
    workers: int | None = None


def run_study(config: StudyConfig, advance: Advance = silent) -> Study:
    """Compute everything that `config.figure` needs, as plain JSON data. Takes minutes; `advance` counts the jobs."""
    began = time.monotonic()
    everything = config.figure == "all"
    study: Study = {"figure": config.figure, "choices": vars(Choices()), "machine": machine()}
    with Batch(advance, config.workers) as batch:
        if everything or config.figure == "2":
            study["convergence"] = _convergence(batch)
        if everything or config.figure != "2":
            measured = _headline(batch, config, study)
        if everything:
            study["claims"] = [claim.model_dump(mode="json") for claim in claims(study, measured)]
            study["sensitivity"] = _sensitivity(batch)
            study["ablation"] = _ablation(batch, config)
    study["seconds"] = round(time.monotonic() - began, 1)
    return study


def claims(study: Study, measured: Mapping[str, Mapping[str, Array]]) -> list[Judged]:
    """Return every claim of the letter, judged."""
    return judged(measured, {mu: row["utility_kbps"] for mu, row in study["convergence"].items()})


def cases(config: StudyConfig) -> list[tuple[Choices, str]]:
    """Return (layout, failing UAV) of every case; the first layout is the calibrated one."""
    first = Choices()
    layouts = [first, *(replace(first, layout_seed=100 + i, fading_seed=100 + i) for i in range(config.layouts - 1))]
    return [(choices, failed) for choices in layouts for failed in FAILED]


def _schemes(figure: str) -> list[Scheme]:
    mus = MUS if figure in ("all", "5a", "5b") else SHOWN_MUS
    return [*COMPARED, *(pro_alg(kind, mu) for kind in KINDS for mu in mus)]


def _headline(batch: Batch, config: StudyConfig, study: Study) -> dict[str, dict[str, Array]]:
    """Compute figs. 3 and 5: every scheme on every case. Return scheme -> measure -> value of each case."""
    schemes, flown = _schemes(config.figure), cases(config)
    courses = batch.run(compute, [Job(choices, scheme, failed) for scheme in schemes for choices, failed in flown])
    measured: dict[str, dict[str, Array]] = {}
    for scheme in schemes:
        rows = [courses[Job(choices, scheme, failed)].measures() for choices, failed in flown]
        measured[scheme.name] = {key: np.array([row[key] for row in rows]) for key in rows[0]}
    study["cases"] = len(flown)
    study["headline"] = {
        name: {key: {"mean": float(values.mean()), "spread": float(values.std())} for key, values in row.items()}
        for name, row in measured.items()
    }
    example = flown[len(FAILED) - 1]  # the calibrated layout, the last UAV fails
    study["periods"] = {
        scheme.name: courses[Job(example[0], scheme, example[1])].sum_kbps.tolist() for scheme in schemes
    }
    study["gap"] = _gaps(courses, schemes)
    if config.figure in ("all", "5a", "5b"):
        study["along_mu"] = {
            kind: {
                measure: {"mean": curve.mean(axis=1).tolist(), "spread": curve.std(axis=1).tolist()}
                for measure in ("variance", "jain", "mean")
                for curve in (along_mu(measured, kind, measure)[1:],)
            }
            for kind in KINDS
        }
    return measured


def _gaps(courses: Mapping[Job, Course], schemes: Sequence[Scheme]) -> dict[str, float]:
    return {
        scheme.name: float(np.mean([course.gap for job, course in courses.items() if job.scheme == scheme]))
        for scheme in schemes
        if scheme.method == "fast"
    }


@dataclass(frozen=True)
class Convergence:
    """Algorithm 1 as printed on the calibrated scenario; runs in a worker process."""

    mu_per_kbps: float


def iterate(job: Convergence) -> dict[str, list[float]]:
    """Return utility and mean sum rate after each iteration, kbit/s."""
    scenario = Choices().scenario(Utility(kind="sum", mu_per_kbps=job.mu_per_kbps))
    history = plan(scenario, method="paper", stop=MaxIterations(ITERATIONS)).history
    return {
        "utility_kbps": [step.utility_bps / 1e3 for step in history],
        "sum_rate_kbps": [step.mean_sum_rate_bps / 1e3 for step in history],
    }


def _convergence(batch: Batch) -> dict[str, dict[str, list[float]]]:
    found = batch.run(iterate, [Convergence(mu) for mu in CONVERGENCE_MUS])
    return {f"{job.mu_per_kbps:g}": history for job, history in found.items()}


def _sensitivity(batch: Batch) -> list[dict[str, Any]]:
    """Vary each omitted choice alone: three layouts, each UAV failing, means of the letter's numbers."""
    base = Choices()
    variants: list[tuple[str, Choices]] = [("calibrated", base)]
    variants += [(f"noise {noise:g} dBm", replace(base, noise_dbm=noise)) for noise in (-60.0, -55.0, -50.0)]
    variants += [
        (f"users within {radius:g} m" if radius else "users anywhere", replace(base, user_radius_m=radius))
        for radius in (60.0, 90.0, 120.0, None)
    ]
    other_fading: Literal["mean", "sampled"] = "sampled" if base.fading == "mean" else "mean"
    variants.append((f"{other_fading} fading", replace(base, fading=other_fading)))
    schemes = [*COMPARED, *(pro_alg(kind, MUS[-1]) for kind in KINDS)]
    jobs = {
        name: [
            Job(replace(choices, layout_seed=seed, fading_seed=seed), scheme, failed)
            for scheme in schemes
            for seed in (base.layout_seed, 100, 101)
            for failed in FAILED
        ]
        for name, choices in variants
    }
    courses = batch.run(compute, [job for each in jobs.values() for job in each])
    rows = []
    for name, each in jobs.items():
        row: dict[str, Any] = {"choice": name}
        for scheme in schemes:
            mine = [courses[job].measures() for job in each if job.scheme == scheme]
            row[scheme.name] = {key: float(np.mean([one[key] for one in mine])) for key in mine[0]}
        rows.append(row)
    return rows


def _ablation(batch: Batch, config: StudyConfig) -> dict[str, Any]:
    layouts = list(dict.fromkeys(choices for choices, _ in cases(config)))
    jobs = [ablation.Layout(choices) for choices in layouts]
    found: dict[str, Any] = {
        "parts": ablation.mean_rows(list(batch.run(ablation.parts, jobs).values())),
        "solvers": ablation.mean_rows(list(batch.run(ablation.solvers, jobs).values())),
        "foresight": {},
    }
    for utility in (Utility(kind="sum", mu_per_kbps=-0.1), Utility(kind="pooled", mu_per_kbps=-0.3)):
        foresights = [ablation.Foresight(choices, failed, utility) for choices, failed in cases(config)]
        rows = ablation.mean_rows(list(batch.run(ablation.foresight, foresights).values()))
        found["foresight"][f"{utility.kind}, mu = {utility.mu_per_kbps:g}"] = rows
    return found


def pictures(study: Study) -> dict[str, Any]:
    """Return the matplotlib figures of what the study holds, by file stem."""
    drawn: dict[str, Any] = {}
    figure = study["figure"]
    if "convergence" in study:
        drawn["fig2-convergence"] = figures.convergence(study["convergence"])
    if figure in ("all", "3"):
        for kind in KINDS:
            names = [*(scheme.name for scheme in COMPARED), *(pro_alg(kind, mu).name for mu in SHOWN_MUS)]
            curves = {name: study["periods"][name] for name in names}
            drawn[f"fig3-periods-{kind.replace('_', '-')}"] = figures.periods(
                curves, f"utility {kind}, {FAILED[-1]} fails"
            )
    for key, measure, label, printed in (
        (
            "5a",
            "variance",
            "variance of the sum rate, (kbit/s)²",
            {"letter, µ = -10": 48.97, "letter, Baseline 2": 119.4},
        ),
        ("5b", "jain", "Jain index", {"letter, SR-Max": 0.65, "letter, Baseline 1": 0.876}),
    ):
        if figure in ("all", key):
            curves_mu = {
                kind: (study["along_mu"][kind][measure]["mean"], study["along_mu"][kind][measure]["spread"])
                for kind in KINDS
            }
            levels = {scheme.name: study["headline"][scheme.name][measure]["mean"] for scheme in COMPARED}
            drawn[f"fig{key}-{measure}"] = figures.against_mu(MUS, curves_mu, {**levels, **printed}, label)
    return drawn


def write(study: Study, out: Path, document: Callable[[Study], str]) -> list[Path]:
    """Write `reproduction/study.json`, the pictures, and `reproduction.md`. Return the paths."""
    folder = out / "reproduction"
    folder.mkdir(parents=True, exist_ok=True)
    written = [folder / "study.json"]
    written[0].write_text(json.dumps(study, indent=1) + "\n", encoding="utf-8")
    for stem, figure in pictures(study).items():
        written.append(folder / f"{stem}.svg")
        figure.savefig(written[-1], metadata={"Date": None})
    if study["figure"] == "all":
        written.append(out / "reproduction.md")
        written[-1].write_text(document(study), encoding="utf-8")
    return written
