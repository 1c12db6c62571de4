"""The write-up: every number in it comes from the study's data."""

from __future__ import annotations

from itertools import product

from skyfolio.api.lab.reproduce.calibrated import calibrated
from skyfolio.api.lab.reproduce.claims import KINDS, MUS
from skyfolio.api.lab.reproduce.courses import COMPARED, FAILED, READINGS, pro_alg
from skyfolio.api.lab.reproduce.markdown import figure, means, names, table, text
from skyfolio.api.lab.reproduce.settling import settling, statement
from skyfolio.api.lab.reproduce.study import Study
from skyfolio.api.lab.reproduce.verdicts import Judged, Verdict

FADINGS = {"mean": "at its mean", "sampled": "drawn in every slot", "held": "drawn once for each link"}
KNOWN = {
    "draw": "which planners know",
    "expectation": "of which planners know the distribution",
    "statistics": "of which planners know the mean alone",
}
COUNTED = {1: "one reading", 2: "two readings", 3: "three readings"}


def document(study: Study) -> str:
    """Return the `reproduction.md` of a whole study, GitHub-flavoured Markdown."""
    parts = [
        _head(study),
        _claims(study),
        _figures(),
        _utilities(study),
        *([calibrated(study["calibration"])] if study["calibration"] else []),
        _ablation(study),
        _again(study),
    ]
    return "\n\n".join(part.strip() for part in parts) + "\n"


def _head(study: Study) -> str:
    choices = study["choices"]
    radius = choices["user_radius_m"]
    where = "anywhere" if radius is None else f"within {radius:g} m of the UAVs' starts, {_near(choices['split'])}"
    claims = _judged(study)
    counts = {verdict: sum(one.verdict is verdict for one in claims) for verdict in Verdict}
    said = {statement(one) for one in claims}
    met = {statement(one) for one in claims if one.verdict is Verdict.REPRODUCED}
    channel = f"{FADINGS[choices['fading']]}" + ("" if choices["fading"] == "mean" else f", {KNOWN[choices['knows']]}")
    return "\n\n".join(
        [
            "# Does it give the letter's results?",
            text(
                f"""Of {len(claims)} claims, {counts[Verdict.REPRODUCED]} are reproduced,
                {counts[Verdict.TREND_ONLY]} in trend only, {counts[Verdict.OPEN]} open, and {counts[Verdict.NOT]} not
                reproducible. The letter does not give transmit power, noise, user positions, slot length, area, the
                fading that was drawn, how many draws were averaged, which UAV fails, how its Baseline 2 places UAVs, or
                the unit of mu, so nothing here claims to be its very experiment: regime, ordering and trend are
                compared, with the numbers side by side."""
            ),
            text(
                f"""A curve is the mean of the rates per slot over {choices["draws"]} draws; variance and Jain's index
                are taken of that mean. Noise {choices["noise_dbm"]:g} dBm, users {where}, fading {channel}. Numbers are
                means over {study["cases"]} cases (a third as many under `per_user` and `pooled`): user layouts that the
                calibration has not seen, each with {", ".join(FAILED)} failing in turn at the start of slot 11, unknown
                to the planners before it. ± is half a 95 % confidence interval over layouts, each of which has draws of
                its own; the part of it that
                draws alone give is named. `mu` is in 1/(kbit/s). The `calibrated` example is the first of these
                layouts in its first draw. The `paper` example, for planning and flying, stays at the mean channel,
                which is what a fleet knows before anything is drawn, with three users near each start."""
            ),
            text(
                f"""The letter says each thing once, {len(said)} things in all; three utilities and
                {COUNTED[len(READINGS)]} of Baseline 2 make several claims of one, which exclude one another: a number
                that is met under one utility is not met under a utility that gives another number. {len(met)} of the
                {len(said)} are reproduced under at least one reading, and under one reading at a time:"""
            ),
            _readings(study),
            _printed(study, claims),
        ]
    )


def _printed(study: Study, claims: list[Judged]) -> str:
    """Count the numbers that are met under the letter's own utility and the reading that the joint fit picks."""
    if not study["calibration"]:
        return ""
    reading = f"Baseline 2 ({study['calibration']['refined']['best']['setting']['baseline_2']})"
    printed = [one for one in claims if one.paper and one.kind in (None, "sum") and one.reading in (None, reading)]
    met = sum(one.verdict is Verdict.REPRODUCED for one in printed)
    return text(
        f"""Under `sum`, the letter's eq. (9), and {reading}, which the joint fit picks, {met} of its {len(printed)}
        numbers are reproduced, none of which was fitted on these layouts."""
    )


def _near(split: str) -> str:
    if split == "drawn":
        return "near which one drawn for each user"
    first, *others = split.split(", ")
    return f"{first} near one, {' and '.join(others)} near the others, in an order drawn for each layout"


def _judged(study: Study) -> list[Judged]:
    return [Judged.model_validate(one) for one in study["claims"]]


def _readings(study: Study) -> str:
    """Count the claims that hold under each utility and reading of Baseline 2, taken together."""
    rows = []
    for kind, reading in product(KINDS, (scheme.name for scheme in READINGS)):
        mine = [one for one in study["claims"] if one["kind"] in (None, kind) and one["reading"] in (None, reading)]
        counts = [sum(one["verdict"] == verdict for one in mine) for verdict in Verdict]
        rows.append((f"`{kind}`, {reading}", *map(str, counts), str(len(mine))))
    return table(("utility and reading", *(verdict.value for verdict in Verdict), "of"), rows)


def _claims(study: Study) -> str:
    rows, reasons = [], []
    claims = _judged(study)
    for one in claims:
        paper = "-" if one.paper is None else figure(one.paper)
        half = "" if one.half is None else f" ± {figure(one.half)}"
        draws = "" if one.draws_half is None else figure(one.draws_half)
        rows.append(
            (one.figure, one.claim, paper, figure(one.ours) + half, draws, one.unit, one.verdict.value, one.reason)
        )
        if one.verdict is not Verdict.REPRODUCED:
            reasons.append((one.claim, one.verdict.value, settling(one, claims, study)))
    rule = text(
        """A number is reproduced when it is within 10 % of the letter's, or within 25 % and the letter's is an ordinary
        case here (within one spread over cases); in trend only, when it is within 25 % and the whole interval is
        beyond 10 %; not reproducible, when the whole interval is beyond 25 %; open, when the interval is wider than
        that. A trend is reproduced when it holds for the mean and in 80 % of the cases, and the change differs from
        none with 95 % confidence; in trend only, when it holds for the mean and in fewer cases; open, when the change
        does not differ from none."""
    )
    head = ("fig.", "claim", "letter", "ours", "of it draws", "unit", "verdict", "why")
    return "\n\n".join(
        [
            "## The claims",
            rule,
            table(head, rows),
            "What is not reproduced, and what would settle it:",
            table(("claim", "verdict", "why, or what would settle it"), reasons),
        ]
    )


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
        f"Its two trends, variance falling and fairness growing with |mu|, appear together under {names(both)}."
        if both
        else "Its two trends appear together under none of the three utilities."
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
            *(pro_alg(kind, mu).name for kind in KINDS for mu in MUS),
        )
    ]
    first, last = (headline[name]["jain"]["mean"] for name in (weak, strong))
    return "\n\n".join(
        [
            "## Which utility, and which unit of mu",
            text(
                f"""The letter's text optimises its eq. (9), the exponential utility of the SUM rate (`sum`), while its
                goal, eq. (5), is a mean-variance sum per USER (`per_user`); `pooled` also trades between users.
                {says}"""
            ),
            table(("utility", *next(iter(trends.values()))), rows),
            text(
                f"""Under `sum`, in every single draw, the best association and bandwidth of a slot at given positions
                do not depend on mu, whatever its unit: mu acts through the trajectories alone. That is a theorem
                about one realisation, and it implies nothing for the mean over draws: where the gains change from slot
                to slot, other trajectories make other users the best ones, and from mu = {MUS[0]:g} to {MUS[-1]:g}
                the Jain index moves from {first:.3f} to {last:.3f}. It does imply that no utility of the sum rate can
                serve a user for fairness' sake: what fairness there is comes from the draws. The axis of the letter's
                Fig. 5 has no unit. In 1/(kbit/s), -10 is max-min over slots to any practical accuracy (at sum rates
                near 100 kbit/s the exponent is near -1000); in 1/(Mbit/s) it would be -0.01 here, which hardly
                acts."""
            ),
            table(
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
    return {name: verdicts[claim] in (Verdict.REPRODUCED, Verdict.TREND_ONLY) for name, claim in questions.items()}


def _ablation(study: Study) -> str:
    found = study["ablation"]
    gap = {name: value for name, value in study["gap"].items() if name.startswith("Pro-Alg sum")}
    foresight = "\n\n".join(
        f"Utility {name}:\n\n" + means(rows, "kbit/s, all slots") for name, rows in found["foresight"].items()
    )
    return "\n\n".join(
        [
            "## What the letter does not show",
            "What each part contributes to the mean sum rate (no failure):",
            means(found["parts"], "kbit/s"),
            "Alternation as printed against the exact joint step, one start against many, and the certificate:",
            means(found["solvers"], "kbit/s"),
            text(
                f"""Over all cases the certified gap of the `sum` plans is {min(gap.values()):.1%} to
                {max(gap.values()):.1%} (mean for each mu)."""
            ),
            "What a loss costs, what replanning brings back, and what knowing it beforehand would have been worth:",
            foresight,
        ]
    )


def _again(study: Study) -> str:
    machine, calibration = study["machine"], study["calibration"]
    spent = f" ({calibration['core_seconds']:.0f} s of processor time)" if calibration else ""
    return "## Do it again\n\n" + text(
        f"""`skyfolio reproduce --out docs` wrote this page, its pictures and `study.json`. It took
        {study["core_seconds"]:.0f} s of processor time ({machine["cpu"]}), half of that on two cores. `--layouts` and
        `--draws` ask for more; `--draws` changes what is averaged, and with it every variance. `--calibrate` flies the
        settings of what the letter omits again{spent} and keeps `calibration.json`, which this page takes in. Baseline
        2 follows the letter's one sentence on it (placement and bandwidth, nearest association), in
        {COUNTED[len(READINGS)]}: its source was not at hand."""
    )
