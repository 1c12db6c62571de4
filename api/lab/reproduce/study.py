"""The whole reproduction: run the courses, judge the claims, collect every number that is drawn or written."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from skyfolio.api.lab.bench.measure import machine
from skyfolio.api.lab.reproduce import ablation, figures
from skyfolio.api.lab.reproduce.batch import Runs
from skyfolio.api.lab.reproduce.claims import KINDS, MUS, along_mu, judged
from skyfolio.api.lab.reproduce.courses import COMPARED, FAILED, FIRST_LAYOUT, Choices, Job, Scheme, compute, pro_alg
from skyfolio.api.lab.reproduce.estimates import Measured, measured_of
from skyfolio.api.lab.reproduce.verdicts import Judged
from skyfolio.planner import MaxIterations, Utility, plan

Study = dict[str, Any]
FIGURES = ("2", "3", "5a", "5b", "all")
CONVERGENCE_MUS = (0.0, -0.01, -0.1, -1.0, -10.0)
SHOWN_MUS = (-0.1, -1.0, -10.0)
MEASURES = ("period_1", "period_2", "mean", "variance", "jain")
ABLATED = 3
ITERATIONS = 8


@dataclass(frozen=True, kw_only=True)
class StudyConfig:
    """The extent of a study.

    figure: one of FIGURES. layouts: how many user layouts, each with every UAV failing in turn and its own fading; a
    third of them under `per_user` and `pooled`, whose plans take ten times as long.

    draws: how many draws of the fading are averaged before anything is measured (default: as calibrated).
    """

    figure: str = "all"
    layouts: int = 18
    draws: int = Choices.draws


def run_study(config: StudyConfig, runs: Runs, calibration: dict[str, Any] | None = None) -> Study:
    """Compute everything that `config.figure` needs, as plain JSON data. Takes minutes.

    runs: what computes the jobs. calibration: what `calibrate` has found, if it is to be in the write-up.
    """
    began = time.monotonic()
    everything = config.figure == "all"
    study: Study = {"figure": config.figure, "choices": asdict(_choices(config)), "machine": machine()}
    if everything or config.figure == "2":
        study["convergence"] = _convergence(runs)
    if everything or config.figure != "2":
        measured = _headline(runs, config, study)
    if everything:
        study["claims"] = [one.model_dump(mode="json") for one in claims(study, measured)]
        study["ablation"] = _ablation(runs, config)
        study["calibration"] = calibration
    study["core_seconds"] = round(runs.core_seconds, 1)
    study["seconds"] = round(time.monotonic() - began, 1)
    return study


def claims(study: Study, measured: Measured) -> list[Judged]:
    """Return every claim of the letter, judged."""
    return judged(measured, {mu: row["utility_kbps"] for mu, row in study["convergence"].items()})


def layouts(config: StudyConfig) -> list[Choices]:
    """Return the calibrated choices on layouts that the calibration has not seen."""
    return [replace(_choices(config), layout_seed=FIRST_LAYOUT + index) for index in range(config.layouts)]


def _choices(config: StudyConfig) -> Choices:
    return replace(Choices(), draws=config.draws)


def _schemes(figure: str) -> list[Scheme]:
    mus = MUS if figure in ("all", "5a", "5b") else SHOWN_MUS
    return [*COMPARED, *(pro_alg(kind, mu) for kind in KINDS for mu in mus)]


def _headline(batch: Runs, config: StudyConfig, study: Study) -> Measured:
    """Compute figs. 3 and 5: every scheme on every layout, with each UAV lost in turn. Fills the study."""
    schemes, choices = _schemes(config.figure), layouts(config)
    jobs = {scheme: [Job(one, scheme) for one in _share(scheme, choices)] for scheme in schemes}
    found = batch.run(compute, [job for scheme in reversed(schemes) for job in jobs[scheme]])
    flown = {scheme.name: [found[job] for job in mine] for scheme, mine in jobs.items()}
    measured = measured_of(flown)
    study["cases"] = len(choices) * len(FAILED)
    study["headline"] = {name: {key: _estimated(measured, name, key) for key in MEASURES} for name in flown}
    study["periods"] = {
        name: np.mean([one.draws_kbps.sum(axis=2).mean(axis=(0, 1)) for one in mine], axis=0).tolist()
        for name, mine in flown.items()
    }
    study["gap"] = {
        scheme.name: float(np.mean([one.gap for one in flown[scheme.name]]))
        for scheme in schemes
        if scheme.method == "fast"
    }
    if config.figure in ("all", "5a", "5b"):
        study["along_mu"] = {kind: {measure: _curve(study, kind, measure) for measure in MEASURES} for kind in KINDS}
    return measured


def _share(scheme: Scheme, choices: list[Choices]) -> list[Choices]:
    """Return all layouts, or the first third of them for plans that take long."""
    return choices if scheme.utility.kind == "sum" else choices[: max(len(choices) // 3, min(len(choices), 2))]


def _estimated(measured: Measured, scheme: str, measure: str) -> dict[str, float]:
    found = measured.estimate(lambda of: of(scheme, measure))
    return {"mean": found.value, "half": found.half, "draws_half": found.draws_half, "spread": found.spread}


def _curve(study: Study, kind: str, measure: str) -> dict[str, list[float]]:
    rows = [study["headline"][name][measure] for name in along_mu(kind)[1:]]
    return {key: [row[key] for row in rows] for key in ("mean", "half")}


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


def _convergence(batch: Runs) -> dict[str, dict[str, list[float]]]:
    found = batch.run(iterate, [Convergence(mu) for mu in CONVERGENCE_MUS])
    return {f"{job.mu_per_kbps:g}": history for job, history in found.items()}


def _ablation(batch: Runs, config: StudyConfig) -> dict[str, Any]:
    """On one draw of the first few layouts: what is compared differs by more than draws do."""
    chosen = layouts(config)[:ABLATED]
    jobs = [ablation.Layout(choices) for choices in chosen]
    found: dict[str, Any] = {
        "parts": ablation.mean_rows(list(batch.run(ablation.parts, jobs).values())),
        "solvers": ablation.mean_rows(list(batch.run(ablation.solvers, jobs).values())),
        "foresight": {},
    }
    for utility in (Utility(kind="sum", mu_per_kbps=-0.1), Utility(kind="pooled", mu_per_kbps=-0.3)):
        asked = [ablation.Foresight(choices, failed, utility) for choices in chosen for failed in FAILED]
        rows = ablation.mean_rows(list(batch.run(ablation.foresight, asked).values()))
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
            drawn[f"fig3-periods-{kind.replace('_', '-')}"] = figures.periods(curves, f"utility {kind}")
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
                kind: (study["along_mu"][kind][measure]["mean"], study["along_mu"][kind][measure]["half"])
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
