"""The planner beside other solvers from the same start, as a terminal table and as the page `planner.md`."""

from __future__ import annotations

from rich.table import Table

from skyfolio.api.lab.bench.figures import Row, figures_of, measured, parts_of
from skyfolio.api.lab.bench.tables import Lines, grid, on_terminal, provenance, target_lines
from skyfolio.api.lab.bench.targets import growths, of_times, ratios

SECTIONS = ("fast", "reference", "ipopt", "ablation", "users", "channels", "energy", "terrain", "proof")
TIMES = (
    "Warm milliseconds, p50 (p99), and the p50 of processor time, which a busy machine lengthens less; utility in "
    "kbit/s. Ours is the optimiser alone, from one start (hovering). The reference path is Algorithm 1 on cvxpy and "
    "Clarabel from the same start. IPOPT (CasADi) plans trajectories in turn with our association and bandwidth from "
    "the same start; its time is that of its own calls, without building the program, and it has no minimum separation "
    "to keep. Where a yardstick has no figure, it takes longer than the benchmark may. Ratios, growth and "
    "targets are of processor time: on an idle core that is the time. How good plans are at their defaults, and what "
    "they take then, is on a page of its own: [quality](quality.md)."
)
CALLS = (
    "`plan()` and `replan()` at their defaults, with certificate, feasibility check and plan object; the replan comes "
    "after the loss of one UAV half-way."
)
USERS = (
    "Calls of `plan()` from one start where all users have tracks, windows, weights or demands, beside the same "
    "users without: means over some layouts, whose climbs take more passes here and fewer there."
)

CHANNELS = (
    "Calls of `plan()` from eight starts under other [kinds of channels](../channels.md), beside the same scenarios "
    "under the letter's: means over some layouts. The goal is at most three times its time."
)


def table(figures: Row) -> Table:
    """Return times and objectives of each size beside the yardsticks'."""
    return on_terminal("one climb from hovering, one core", _sizes(figures))


def markdown(figures: Row) -> str:
    """Return the page; every number comes from `figures`."""
    parts = [
        "# Planner benchmark",
        provenance(figures, SECTIONS),
        "## Time and objective",
        TIMES,
        grid(_sizes(figures)),
        "## Whole calls, replans and memory",
        CALLS,
        grid(_calls(figures)),
        *_windy(figures),
        *_hilly(figures),
        "## Ablation at 3x9x20",
        *[_ablation(kind, case) for _, kind, case in measured(figures, "ablation")],
        "## Users beyond the letter's at 3x9x20",
        USERS,
        grid(_users(figures)),
        "## Kinds of channels",
        CHANNELS,
        grid(_channels(figures)),
        "## Certificate at 3x9x20",
        grid(_proofs(figures)),
        "## Growth",
        *[
            f"`{kind}`: time grows as (U K N)^{growth['plan']:.2f} (cold plan), ^{growth['replan']:.2f} (replan)."
            for kind, growth in growths(figures)
        ],
        "## Targets",
        grid(target_lines(of_times(figures))),
    ]
    return "\n\n".join(parts) + "\n"


def _sizes(figures: Row) -> Lines:
    header = ["U x K x N", "utility", "ms", "cpu ms", "kbit/s", "bound", "reference: ms", "kbit/s", "IPOPT: ms"]
    lines = [[*header, "kbit/s", "ratios"]]
    for size, kind, part in parts_of(figures, "fast"):
        if "figures" not in part:
            lines.append([size, kind, part["skipped"], *[""] * 8])
            continue
        ours, against = part["figures"]["plan"], ratios(figures, size, kind)
        faster = [f"{against[key]:,.0f}x" for key in ("reference plan time", "ipopt plan time") if key in against]
        lines.append(
            [
                size,
                kind,
                f"{ours['p50_ms']:.2f} ({ours['p99_ms']:.2f})",
                f"{ours['cpu_p50_ms']:.2f}",
                f"{ours['utility_kbps']:.2f}",
                f"{part['figures']['bound_kbps']:.1f}",
                *_yardstick(figures_of(figures, "reference", size, kind)),
                *_yardstick(figures_of(figures, "ipopt", size, kind)),
                ", ".join(faster),
            ]
        )
    return lines


def _yardstick(case: Row | None) -> list[str]:
    if case is None:
        return ["-", "-"]
    return [f"{case['plan']['p50_ms']:,.0f}", f"{case['plan']['utility_kbps']:.2f}"]


def _calls(figures: Row) -> Lines:
    lines = [["U x K x N", "utility", "plan() ms", "replan ms", "replan kbit/s", "replan() ms", "gap", "peak MB"]]
    for size, kind, ours in measured(figures, "fast"):
        lines.append(
            [
                size,
                kind,
                f"{ours['plan_call']['p50_ms']:.1f}",
                f"{ours['replan']['p50_ms']:.2f} ({ours['replan']['p99_ms']:.2f})",
                f"{ours['replan']['utility_kbps']:.2f}",
                f"{ours['replan_call']['p50_ms']:.1f}",
                f"{ours['gap']:.1%}",
                f"{ours['peak_mb']:.0f}",
            ]
        )
    return lines


WINDY = (
    "`plan()` and `replan()` at their defaults with wind (3.6 m/s, gusts of 1 m/s, at most 8 m/s through the air), and "
    "with batteries that hold 2 % more than staying at the start takes; ratios are of processor time to still air."
)


def _windy(figures: Row) -> list[str]:
    lines = [["U x K x N", "utility", "still: ms", "kbit/s", "wind: ms", "kbit/s", "ratio", "energy: ms", "kbit/s"]]
    lines[0] += ["ratio", "replan ratio"]
    for size, kind, case in measured(figures, "energy"):
        row = [size, kind]
        for name in ("still", "wind", "energy"):
            row += [f"{case[name]['plan_call']['cpu_p50_ms']:.1f}", f"{case[name]['utility_kbps']:.2f}"]
            row += [f"{case[name]['plan_call']['ratio']:.2f}"] if name != "still" else []
        lines.append([*row, f"{case['energy']['replan_call']['ratio']:.2f}"])
    return ["## With wind and batteries", WINDY, grid(lines)] if len(lines) > 1 else []


HILLY = (
    "`plan()` and `replan()` at their defaults over level ground, over random hills up to 300 m high (60 m above the "
    "highest ground under a leg), and with altitudes chosen between there and 120 m; means over layouts, ratios of "
    "processor time to level ground."
)


def _hilly(figures: Row) -> list[str]:
    lines = [["U x K x N", "utility", "layouts", "level: ms", "kbit/s", "hills: ms", "kbit/s", "ratio", "replan ratio"]]
    lines[0] += ["altitudes chosen: ms", "kbit/s", "ratio", "replan ratio"]
    for size, kind, case in measured(figures, "terrain"):
        row = [size, kind, str(case["layouts"])]
        for name in ("level", "terrain", "altitudes"):
            row += [f"{case[name]['plan_call']['cpu_p50_ms']:.1f}", f"{case[name]['utility_kbps']:.2f}"]
            row += [f"{case[name][call]['ratio']:.2f}" for call in ("plan_call", "replan_call") if name != "level"]
        lines.append(row)
    return ["## Over hills", HILLY, grid(lines)] if len(lines) > 1 else []


def _ablation(kind: str, case: Row) -> str:
    lines = [[f"`{kind}`, mean of {case['layouts']} layouts", "kbit/s", "ms"]]
    lines += [[row["what"], f"{row['utility_kbps']:.2f}", f"{row['ms']:.1f}"] for row in case["rows"]]
    return grid(lines)


def _users(figures: Row) -> Lines:
    lines = [["utility", "users with", "layouts", "plan, ms of processor", "over that without", "gap"]]
    lines += [
        [
            kind,
            row["what"],
            str(case["layouts"]),
            f"{row['cpu_ms']:.2f}",
            f"{row['ratio']:.2f}",
            f"{row['gap']:.1%}",
        ]
        for _, kind, case in measured(figures, "users")
        for row in case["rows"]
    ]
    return lines


def _channels(figures: Row) -> Lines:
    lines = [["size", "utility", "channel", "layouts", "plan, ms of processor", "over that of the letter's", "gap"]]
    for size, kind, case in measured(figures, "channels"):
        for row in case["rows"]:
            cells = [
                row["what"],
                str(case["layouts"]),
                f"{row['cpu_ms']:.2f}",
                f"{row['ratio']:.2f}",
                f"{row['gap']:.1%}",
            ]
            lines.append([size, kind, *cells])
    return lines


def _proofs(figures: Row) -> Lines:
    lines = [["utility", "layouts", "root gap, mean (max)", "after branch and bound", "rectangles", "seconds"]]
    for _, kind, case in measured(figures, "proof"):
        lines.append(
            [
                kind,
                str(case["layouts"]),
                f"{case['root_gap_mean']:.1%} ({case['root_gap_max']:.1%})",
                f"{case['gap_mean']:.1%} ({case['gap_max']:.1%})",
                f"{case['nodes_mean']:,.0f}",
                f"{case['seconds_mean']:.1f}",
            ]
        )
    return lines
