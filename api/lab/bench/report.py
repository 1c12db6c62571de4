"""The benchmark's figures as a terminal table, and as Markdown for `docs/`."""

from __future__ import annotations

from typing import Any

from rich.table import Table

Row = dict[str, Any]
TIMES = (
    "Warm milliseconds, p50 (p99), and the p50 of processor time, which a busy machine lengthens less; utility in "
    "kbit/s. Ours is the optimiser alone, from one start (hovering). The reference path is Algorithm 1 on cvxpy and "
    "Clarabel from the same start. IPOPT (CasADi) plans trajectories in turn with our association and bandwidth from "
    "the same start; its time is that of its own calls, without building the program, and it has no minimum separation "
    "to keep. Where a yardstick has no figure, it takes longer than the benchmark may. Ratios, growth and "
    "targets are of processor time: on an idle core that is the time."
)
QUALITY = (
    "Mean share of the best known value (`best-known.json`: each with how it was found, improved when beaten, never "
    "lowered) over the layouts, for the default budget and multiples of it; processor milliseconds, p50, of the "
    "optimiser at its defaults, and of a replan after a loss half-way, beside what more searching finds then. Peers on "
    "the first layout, as shares of the same best known value; IPOPT only where it ends in minutes."
)
CALLS = (
    "`plan()` and `replan()` at their defaults, with certificate, feasibility check and plan object; the replan comes "
    "after the loss of one UAV half-way."
)


def table(figures: Row) -> Table:
    """Return times and objectives of each size beside the yardsticks'."""
    header, *lines = _sizes(figures)
    times = Table(*header, title=f"planner on {figures['machine']['cpu']}, one core")
    for line in lines:
        times.add_row(*line)
    return times


def markdown(figures: Row) -> str:
    """Return all tables of the benchmark as one Markdown page; every number comes from `figures`."""
    parts = [
        "# Planner benchmark",
        _measured_on(figures["machine"]),
        "## Time and objective",
        TIMES,
        _grid(_sizes(figures)),
        "## Whole calls, replans and memory",
        CALLS,
        _grid(_calls(figures)),
        *(["## Quality", QUALITY, _grid(_quality(figures))] if "quality" in figures else []),
        "## Ablation at 3x9x20",
        *[_ablation(kind, figures["ablation"][kind]) for kind in figures["ablation"]],
        "## Certificate at 3x9x20",
        _grid(_proofs(figures)),
        "## Growth",
        *[
            f"`{kind}`: time grows as (U K N)^{growth['plan_exponent']:.2f} (cold plan), "
            f"^{growth['replan_exponent']:.2f} (replan)."
            for kind, growth in figures["growth"].items()
            if growth
        ],
        "## Targets",
        _grid(_targets(figures)),
    ]
    return "\n\n".join(parts) + "\n"


def _measured_on(machine: Row) -> str:
    return (
        f"Measured by `skyfolio bench planner --json` on {machine['cpu']}, one core of {machine['cores']}, "
        f"{machine['memory_gb']} GB, {machine['platform']}, Python {machine['python']}; load average at the end "
        f"{machine['load']:.1f}. Written by `skyfolio bench report`; do not edit."
    )


def _sizes(figures: Row) -> list[list[str]]:
    lines = [
        [
            "U x K x N",
            "utility",
            "ms",
            "cpu ms",
            "kbit/s",
            "bound",
            "reference: ms",
            "kbit/s",
            "IPOPT: ms",
            "kbit/s",
            "ratios",
        ]
    ]
    for row in figures["rows"]:
        ours = row["fast"].get("plan")
        if not ours:
            lines.append([row["size"], row["kind"], row["fast"]["skipped"], *[""] * 8])
            continue
        ratios = row["ratios"]
        lines.append(
            [
                row["size"],
                row["kind"],
                f"{ours['p50_ms']:.2f} ({ours['p99_ms']:.2f})",
                f"{ours['cpu_p50_ms']:.2f}",
                f"{ours['utility_kbps']:.2f}",
                f"{row['fast']['bound_kbps']:.1f}",
                *_yardstick(row["reference"]),
                *_yardstick(row["ipopt"]),
                ", ".join(
                    f"{ratios[key]:,.0f}x" for key in ("reference_plan_time", "ipopt_plan_time") if key in ratios
                ),
            ]
        )
    return lines


def _yardstick(case: Row) -> list[str]:
    if "plan" not in case:
        return ["-", "-"]
    return [f"{case['plan']['p50_ms']:,.0f}", f"{case['plan']['utility_kbps']:.2f}"]


def _calls(figures: Row) -> list[list[str]]:
    lines = [["U x K x N", "utility", "plan() ms", "replan ms", "replan kbit/s", "replan() ms", "gap", "peak MB"]]
    for row in figures["rows"]:
        ours = row["fast"]
        if "plan" in ours:
            lines.append(
                [
                    row["size"],
                    row["kind"],
                    f"{ours['plan_call']['p50_ms']:.1f}",
                    f"{ours['replan']['p50_ms']:.2f} ({ours['replan']['p99_ms']:.2f})",
                    f"{ours['replan']['utility_kbps']:.2f}",
                    f"{ours['replan_call']['p50_ms']:.1f}",
                    f"{ours['gap']:.1%}",
                    f"{ours['peak_mb']:.0f}",
                ]
            )
    return lines


def _quality(figures: Row) -> list[list[str]]:
    lines = [["U x K x N", "utility", "layouts", "1x", "2x", "10x", "ms", "replan ms", "replan share", "peers"]]
    for size, by_kind in figures["quality"].items():
        for kind, case in by_kind.items():
            if "share" not in case:
                lines.append([size, kind, case["skipped"], *[""] * 7])
                continue
            shares = [f"{case['shares'][b]:.2%}" if b in case["shares"] else "-" for b in ("1", "2", "10")]
            lines.append(
                [
                    size,
                    kind,
                    str(len(case["instances"])),
                    *shares,
                    f"{case['plan_cpu_ms']:.0f}",
                    f"{case['replan_cpu_ms']:.0f}",
                    f"{case['replan_share']:.2%}",
                    ", ".join(f"{name} {peer['share']:.1%}" for name, peer in case.get("peers", {}).items()),
                ]
            )
    return lines


def _ablation(kind: str, case: Row) -> str:
    if "rows" not in case:
        return f"`{kind}`: {case['skipped']}"
    lines = [[f"`{kind}`, mean of {case['layouts']} layouts", "kbit/s", "ms"]]
    lines += [[row["what"], f"{row['utility_kbps']:.2f}", f"{row['ms']:.1f}"] for row in case["rows"]]
    return _grid(lines)


def _proofs(figures: Row) -> list[list[str]]:
    lines = [["utility", "layouts", "root gap, mean (max)", "after branch and bound", "rectangles", "seconds"]]
    for kind, case in figures["proof"].items():
        if "gap_mean" in case:
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


def _targets(figures: Row) -> list[list[str]]:
    lines = [["what", "measured", "asked", "met"]]
    for one in figures["targets"]:
        asked = f"<= {one['at_most']:g}" if "at_most" in one else f">= {one['at_least']:g}"
        lines.append([one["what"], f"{one['measured']:.4g}", asked, "yes" if one["met"] else "**no**"])
    return lines


def _grid(lines: list[list[str]]) -> str:
    header, *rows = ["| " + " | ".join(line) + " |" for line in lines]
    return "\n".join([header, "|" + "---|" * len(lines[0]), *rows])
