"""The write-up: every number in it comes from the study's data."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from textwrap import fill
from typing import Any

from skyfolio.api.lab.reproduce.claims import KINDS, MUS, Judged, Verdict
from skyfolio.api.lab.reproduce.courses import COMPARED, FAILED, READINGS, pro_alg
from skyfolio.api.lab.reproduce.study import Study


def document(study: Study) -> str:
    """Return the `reproduction.md` of a whole study, GitHub-flavoured Markdown."""
    parts = [
        _head(study),
        _claims(study),
        _figures(),
        _utilities(study),
        _sensitivity(study),
        _ablation(study),
        _again(study),
    ]
    return "\n\n".join(part.strip() for part in parts) + "\n"


def _head(study: Study) -> str:
    choices = study["choices"]
    where = (
        "anywhere" if choices["user_radius_m"] is None else f"within {choices['user_radius_m']:g} m of a UAV's start"
    )
    counts = {verdict: sum(claim["verdict"] == verdict for claim in study["claims"]) for verdict in Verdict}
    return "\n\n".join(
        [
            "# Does it give the letter's results?",
            _text(
                f"""Of {len(study["claims"])} claims, {counts[Verdict.REPRODUCED]} are reproduced,
                {counts[Verdict.TREND_ONLY]} in trend only, and {counts[Verdict.NOT]} are not reproducible. The letter
                does not give transmit power, noise, user positions, slot length, area, the fading that was drawn, which
                UAV fails, or the unit of mu, so nothing here claims to be its very experiment: regime, ordering and
                trend are compared, with the numbers side by side."""
            ),
            _text(
                f"""What it omits was calibrated on its numbers that do not depend on mu: noise
                {choices["noise_dbm"]:g} dBm, users {where}, {choices["fading"]} fading, layout seed
                {choices["layout_seed"]}. That is the `paper` example. Means and spreads are over {study["cases"]}
                cases: user layouts, each with {", ".join(FAILED)} failing in turn at the start of slot 11, unknown to
                the planners before it. `mu` is in 1/(kbit/s)."""
            ),
        ]
    )


def _claims(study: Study) -> str:
    rows = []
    for each in study["claims"]:
        claim = Judged.model_validate(each)
        paper = "-" if claim.paper is None else _number(claim.paper)
        spread = "" if claim.spread is None else f" ± {_number(claim.spread)}"
        rows.append(
            (
                claim.figure,
                claim.claim,
                paper,
                _number(claim.ours) + spread,
                claim.unit,
                claim.verdict.value,
                claim.reason,
            )
        )
    heading = "## The claims\n\n"
    return heading + _table(("fig.", "claim", "letter", "ours", "unit", "verdict", "why"), rows)


def _figures() -> str:
    return "\n\n".join(
        [
            "## The figures",
            "![Fig. 2: utility and sum rate after each iteration](reproduction/fig2-convergence.svg)",
            *(f"![Fig. 3, utility {kind}](reproduction/fig3-periods-{kind.replace('_', '-')}.svg)" for kind in KINDS),
            "![Fig. 5(a): variance of the sum rate against mu](reproduction/fig5a-variance.svg)",
            "![Fig. 5(b): Jain index against mu](reproduction/fig5b-jain.svg)",
        ]
    )


def _utilities(study: Study) -> str:
    trends = {kind: _shows(study, kind) for kind in KINDS}
    both = [kind for kind, shown in trends.items() if shown["variance falls"] and shown["Jain index grows"]]
    says = (
        f"The letter's two trends, variance falling and fairness growing with |mu|, appear together under {_and(both)}."
        if both
        else "The letter's two trends appear together under none of the three utilities."
    )
    rows = [(kind, *("yes" if shown else "no" for shown in trends[kind].values())) for kind in KINDS]
    weak, strong = pro_alg("sum", MUS[0]).name, pro_alg("sum", MUS[-1]).name
    headline = study["headline"]
    measures = [
        (
            name,
            *(f"{headline[name][key]['mean']:.2f}" for key in ("period_1", "period_2", "mean", "variance", "jain")),
        )
        for name in (
            *(scheme.name for scheme in COMPARED),
            *(pro_alg(kind, mu).name for kind in KINDS for mu in (MUS[0], MUS[3], MUS[-1])),
        )
    ]
    first, last = (headline[name]["jain"]["mean"] for name in (weak, strong))
    return "\n\n".join(
        [
            "## Which utility, and which unit of mu",
            _text(
                f"""The letter's text optimises its eq. (9), the exponential utility of the SUM rate (`sum`), while its
                goal, eq. (5), is a mean-variance sum per USER (`per_user`); `pooled` also trades between users.
                {says}"""
            ),
            _table(("utility", *next(iter(trends.values()))), rows),
            _text(
                f"""Under `sum` the best association and bandwidth of a slot do not depend on mu at all, whatever its
                unit: mu acts through the trajectories alone, and from mu = {MUS[0]:g} to {MUS[-1]:g} the Jain index
                moves from {first:.3f} to {last:.3f}. The axis of the letter's Fig. 5 has no unit. In 1/(kbit/s), -10 is
                max-min over slots to any practical accuracy (at sum rates near 100 kbit/s the exponent is near -1000);
                in 1/(Mbit/s) it would be -0.01 here, which hardly acts."""
            ),
            _table(
                ("scheme", "period 1, kbit/s", "period 2, kbit/s", "all slots, kbit/s", "variance, (kbit/s)²", "Jain"),
                measures,
            ),
        ]
    )


def _shows(study: Study, kind: str) -> dict[str, bool]:
    verdicts = {claim["claim"]: claim["verdict"] for claim in study["claims"]}
    questions = {
        "variance falls": f"{kind}: variance falls with |mu|",
        "sum rate falls": f"{kind}: sum rate falls with |mu|",
        "Jain index grows": f"{kind}: Jain index grows with |mu|",
    }
    return {name: verdicts[claim] != Verdict.NOT for name, claim in questions.items()}


def _sensitivity(study: Study) -> str:
    columns = (
        ("SR-Max, period 1", "SR-Max", "period_1"),
        *((f"{scheme.name}, period 1", scheme.name, "period_1") for scheme in READINGS),
        ("Baseline 1, period 1", "Baseline 1", "period_1"),
        ("SR-Max, period 2", "SR-Max", "period_2"),
        *((f"{scheme.name}, variance", scheme.name, "variance") for scheme in READINGS),
        *((f"{kind}, variance at {MUS[-1]:g}", pro_alg(kind, MUS[-1]).name, "variance") for kind in KINDS),
        ("SR-Max, Jain", "SR-Max", "jain"),
        ("Baseline 1, Jain", "Baseline 1", "jain"),
    )
    rows = [
        (row["choice"], *(_number(row[scheme][measure]) for _, scheme, measure in columns))
        for row in study["sensitivity"]
    ]
    return "## What each omitted choice does\n\nEach varied alone, the others as calibrated.\n\n" + _table(
        ("choice", *(title for title, _, _ in columns)), rows
    )


def _ablation(study: Study) -> str:
    found = study["ablation"]
    gap = {name: value for name, value in study["gap"].items() if name.startswith("Pro-Alg sum")}
    foresight = "\n\n".join(
        f"Utility {name}:\n\n" + _rows(rows, "kbit/s, all slots") for name, rows in found["foresight"].items()
    )
    return "\n\n".join(
        [
            "## What the letter does not show",
            "What each part contributes to the mean sum rate (no failure):",
            _rows(found["parts"], "kbit/s"),
            "Alternation as printed against the exact joint step, one start against many, and the certificate:",
            _rows(found["solvers"], "kbit/s"),
            _text(
                f"""Over all cases the certified gap of the `sum` plans is {min(gap.values()):.1%} to
                {max(gap.values()):.1%} (mean for each mu)."""
            ),
            "What a loss costs, what replanning brings back, and what knowing it beforehand would have been worth:",
            foresight,
        ]
    )


def _again(study: Study) -> str:
    machine = study["machine"]
    return "## Do it again\n\n" + _text(
        f"""`skyfolio reproduce --out docs` wrote this page, its pictures and `study.json` in
        {study["seconds"]:.0f} s on {machine["cores"]} cores ({machine["cpu"]}). `skyfolio reproduce --calibrate`
        repeats the search for what the letter omits. Baseline 2 follows the letter's one sentence on it (placement and
        bandwidth, nearest association), in two readings: its source was not at hand."""
    )


def _text(paragraph: str) -> str:
    return fill(" ".join(paragraph.split()), width=118, break_long_words=False, break_on_hyphens=False)


def _rows(rows: Iterable[dict[str, Any]], unit: str) -> str:
    return _table(("", unit), [(row["name"], f"{row['mean']:.2f} ± {row['spread']:.2f}") for row in rows])


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)


def _number(value: float) -> str:
    return f"{value:.3f}" if abs(value) < 2 else f"{value:.2f}" if abs(value) < 100 else f"{value:.1f}"


def _and(names: Sequence[str]) -> str:
    return " and ".join(f"`{name}`" for name in names)
