"""How good plans of fleets are, as the page `quality.md`: every number comes from the files of figures."""

from __future__ import annotations

from collections.abc import Iterator

from rich.table import Table

from skyfolio.api.lab.bench.best_known import Table as Known
from skyfolio.api.lab.bench.figures import Row, figures_of, measured
from skyfolio.api.lab.bench.instances import NOISE_DBM
from skyfolio.api.lab.bench.shares import gap, mean, replan_shares, searched_s, share, values_of
from skyfolio.api.lab.bench.tables import Lines, grid, on_terminal, provenance, target_lines
from skyfolio.api.lab.bench.targets import of_quality

SECTIONS = ("quality", "bound", "budgets", "peers", "disruption", "checked")
INTRODUCTION = (
    "Random users as eight layouts have them: uniform (3), clustered (2), stadium, corridor, two towns; area of side "
    "500 m x sqrt(U/3), starts on a grid, noise -60 dBm where nothing else is said. Everything is at its defaults, on "
    "one core. Times are milliseconds of processor time, p50 of warm calls, mean over layouts: on an idle core that is "
    "the time. A *share* is that of the best value that is known for the instance ([best-known.json](best-known.json): "
    "each with how it was found, improved when beaten, never lowered). It says that no better one was found, not that "
    "there is nothing better: *searched* is for how many seconds the planner was made to search the instance that was "
    "searched the least, 0 where the best known value is only that of some plan. What can be proven is the *gap*."
)
PLANS = (
    "`plan()` and `replan()` are whole calls, with certificate, feasibility check and plan object; the optimiser in "
    "them alone stands beside. The replan follows the loss of one UAV half-way; its share is of the best of it, a cold "
    "plan and twelve starts. Gap: bound over utility, less one, as it comes with the plan; mean (greatest)."
)
BUDGETS = "The share that multiples of the default number of starts reach, on the layouts that were given more."
BOUND = (
    "What `skyfolio bound` proves of a default plan in so many seconds of processor time, beside the plan's own gap. "
    "Why it does not prove more, and what else was tried, is in [planner.md](../planner.md#the-certificate)."
)
PEERS = (
    "Other ways to plan the first layout, each in about the same time (IPOPT ends the plan that it began): k-means "
    "places and one climb, differential evolution over hover points, and under `sum` IPOPT from hovering and random "
    "flights, and from our places. The dash: it does not end in minutes. The open method of Lyu et al. (2024, dbspf) "
    "is not among them: it plans one UAV, its altitude, transmit power and users' rates within time windows for "
    "proportional fairness, so neither side's plans answer the other's problem."
)
DISRUPTION = (
    "A replan after the loss of one UAV half-way with a `disruption_weight`: the whole call, and what it changes of "
    "the old plan. The first line of each instance is without a weight."
)
CHECKED = (
    "Random scenarios with some of: ends, a UAV that leaves, a no-fly disc, a minimum rate, drawn fading, heights. "
    "Each is planned, and replanned after a loss; every plan is put to the check that knows nothing of the optimiser."
)


def quality_table(figures: Row, known: Known) -> Table:
    """Return what was asked for beside what was measured, for a terminal."""
    return on_terminal("how good plans of fleets are", target_lines(of_quality(figures, known)))


def quality_markdown(figures: Row, known: Known) -> str:
    """Return the page."""
    targets = of_quality(figures, known)
    missed, met, unknown = ([one for one in targets if one["met"] is judged] for judged in (False, True, None))
    verdict = (
        f"Of {len(targets)} targets {len(met)} are met, {len(missed)} missed and {len(unknown)} open: not measured "
    )
    verdict += "yet, or with best known values of which some were not searched for (a plan is no yardstick for itself)."
    sections = [
        ("Targets", verdict, target_lines([*missed, *met, *unknown])),
        ("Plans and replans", PLANS, _plans(figures, known)),
        ("Larger budgets", BUDGETS, _budgets(figures, known)),
        ("What can be proven in a minute", BOUND, _bounds(figures)),
        ("Other ways to plan", PEERS, _peers(figures, known)),
        ("Replans that change little", DISRUPTION, _disruption(figures)),
        ("The independent check", CHECKED, _checked(figures)),
    ]
    texts = [text for title, said, lines in sections for text in (f"## {title}", said, grid(lines))]
    parts = ["# How good plans of fleets are", provenance(figures, SECTIONS), INTRODUCTION, *texts]
    return "\n\n".join(parts) + "\n"


def _alike(rows: list[Row]) -> Iterator[list[Row]]:
    """Yield the instances with the same mu and noise together."""
    conditions = dict.fromkeys((row["noise_dbm"] != NOISE_DBM, row["noise_dbm"], row["mu_per_kbps"]) for row in rows)
    for _, noise, mu in sorted(conditions, key=lambda one: one[0]):
        yield [row for row in rows if (row["noise_dbm"], row["mu_per_kbps"]) == (noise, mu)]


def _plans(figures: Row, known: Known) -> Lines:
    header = ["U x K x N", "utility", "mu", "noise, dBm", "layouts", "share, mean (least)", "searched, s"]
    header += ["`plan()` ms (optimiser)", "gap", "`replan()` ms (optimiser)", "replan share (least)"]
    lines = [header]
    for size, kind, case in measured(figures, "quality"):
        lines += [[size, kind, *_plan_line(rows, known)] for rows in _alike(case["instances"])]
    return lines


def _plan_line(rows: list[Row], known: Known) -> list[str]:
    shares = [share(row["name"], row["utility_kbps"], known) for row in rows]
    gaps, again = [gap(row) for row in rows], replan_shares(rows)
    return [
        f"{rows[0]['mu_per_kbps']:g}",
        f"{rows[0]['noise_dbm']:g}",
        str(len(rows)),
        f"{mean(shares):.2%} ({min(shares):.2%})",
        f"{min(searched_s(row['name'], known) for row in rows):g}",
        f"{_ms([row['plan'] for row in rows])} ({_ms([row['optimiser'] for row in rows])})",
        f"{mean(gaps):.1%} ({max(gaps):.1%})",
        f"{_ms([row['replan']['call'] for row in rows])} ({_ms([row['replan']['optimiser'] for row in rows])})",
        f"{mean(again):.2%} ({min(again):.2%})" if again else "-",
    ]


def _ms(times: list[Row]) -> str:
    return f"{mean([one['cpu_p50_ms'] for one in times]):,.0f}"


def _budgets(figures: Row, known: Known) -> Lines:
    lines = [["U x K x N", "utility", "layouts", "default", "budget", "share", "ms"]]
    for size, kind, case in measured(figures, "budgets"):
        first = {one.name: one for one in values_of("quality", figures_of(figures, "quality", size, kind) or {})}
        for times in dict.fromkeys(row["times"] for row in case["instances"]):
            rows = [row for row in case["instances"] if row["times"] == times]
            usual = [share(row["name"], first[row["name"]].utility_kbps, known) for row in rows if row["name"] in first]
            shares = [share(row["name"], row["utility_kbps"], known) for row in rows]
            once = f"{mean(usual):.2%}" if usual else "-"
            taken = _ms([row["plan"] for row in rows])
            lines.append([size, kind, str(len(rows)), once, f"{times}x", f"{mean(shares):.2%}", taken])
    return lines


def _bounds(figures: Row) -> Lines:
    lines = [["instance", "s", "utility, kbit/s", "no plan has more than", "gap", "gap with the plan"]]
    for size, kind, case in measured(figures, "bound"):
        rows = case["instances"]
        lines += [
            [
                row["name"],
                f"{row['seconds']:.0f}",
                f"{row['utility_bps'] / 1e3:,.1f}",
                f"{row['upper_bound_bps'] / 1e3:,.1f}",
                f"{row['gap']:.1%}",
                f"{row['root_gap']:.1%}",
            ]
            for row in rows
        ]
        gaps, roots = ([row[key] for row in rows] for key in ("gap", "root_gap"))
        lines.append([f"{size} {kind}, mean", *[""] * 3, f"{mean(gaps):.1%}", f"{mean(roots):.1%}"])
    return lines


def _peers(figures: Row, known: Known) -> Lines:
    cases = list(measured(figures, "peers"))
    names = list(dict.fromkeys(name for _, _, case in cases for name in case["peers"]))
    lines = [["instance", "s each", *(f"{name.replace('_', ' ')} (s taken)" for name in names)]]
    for _, _, case in cases:
        found = values_of("peers", case)
        shares = {one.found_by: f"{share(one.name, one.utility_kbps, known):.1%} ({one.seconds:.1f})" for one in found}
        told = [shares.get(f"peer {name}", "-") for name in names]
        lines.append([case["name"], f"{case['seconds_each']:g}", *told])
    return lines


def _disruption(figures: Row) -> Lines:
    lines = [["instance", "weight, kbit/s", "`replan()` ms", "utility, kbit/s", "users' slots changed", "metres off"]]
    for _, _, case in measured(figures, "disruption"):
        lines += [
            [
                row["name"],
                f"{row['weight_kbps']:g}",
                f"{row['call']['cpu_p50_ms']:,.0f}",
                f"{row['utility_kbps']:,.2f}",
                f"{row['user_slots_changed']:,}",
                f"{row['path_changed_m']:,.0f}",
            ]
            for row in case["instances"]
        ]
    return lines


def _checked(figures: Row) -> Lines:
    lines = [["plans", "replans", "broken", "seeds from"]]
    for _, _, case in measured(figures, "checked"):
        broken = ", ".join(f"seed {seed}: {'; '.join(what)}" for seed, what in case["broken"].items()) or "none"
        lines.append([str(case["plans"]), str(case["replans"]), broken, str(case["first_seed"])])
    return lines
