"""The drill's result: a table in the terminal, and one self-contained HTML page."""

from __future__ import annotations

from html import escape
from pathlib import Path

import numpy as np
from rich.console import Group
from rich.table import Table
from rich.text import Text

from skyfolio.api.lab.demo.report import DemoReport
from skyfolio.api.lab.plots import as_svg, new_figure

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#f0e442")
"""Okabe and Ito's palette: distinguishable with colour blindness too."""


def figures(report: DemoReport) -> list[tuple[str, str, str]]:
    """Rows (what, flown, no replan) of the result table."""
    flown, without = report.flown, report.no_replan

    def kbps(value: float | None) -> str:
        return "-" if value is None else f"{value / 1e3:.1f} kbit/s"

    def unit(value: float | None, form: str) -> str:
        return "-" if value is None else form.format(value)

    slots_left = len(without.sum_rate_bps) - report.killed_at_slot + 1
    return [
        ("loss declared after", unit(report.detection_s, "{:.2f} s"), "-"),
        ("replan solved in", unit(report.replan_ms, "{:.0f} ms"), "-"),
        ("missions uploaded, verified, flying in", unit(report.upload_s, "{:.3f} s"), "-"),
        ("slots without service of the lost UAV's users", f"{report.slots_without_service:.1f}", f"{slots_left:.1f}"),
        ("sum rate before", kbps(flown.mean_sum_rate_before_bps), kbps(without.mean_sum_rate_before_bps)),
        ("sum rate during the outage", kbps(flown.mean_sum_rate_during_bps), kbps(without.mean_sum_rate_during_bps)),
        ("sum rate after", kbps(flown.mean_sum_rate_after_bps), kbps(without.mean_sum_rate_after_bps)),
        (f"utility ({report.utility.kind}) of all slots", kbps(flown.utility_bps), kbps(without.utility_bps)),
        ("worst user's mean rate after", kbps(flown.worst_user_after_bps), kbps(without.worst_user_after_bps)),
        ("users without service after", _named(flown.unserved_after), _named(without.unserved_after)),
        (
            "variance of the sum rate",
            f"{flown.sum_rate_variance_kbps2:.1f} (kbit/s)²",
            f"{without.sum_rate_variance_kbps2:.1f} (kbit/s)²",
        ),
        ("Jain index of the users", f"{flown.jain:.3f}", f"{without.jain:.3f}"),
    ]


def _named(users: list[str]) -> str:
    return f"{len(users)} ({', '.join(users)})" if users else "none"


def result_table(report: DemoReport) -> Group:
    """Return the table, the checks, and the verdict."""
    flown = "flown, with replan" if report.replanned else "flown, no replan"
    title = f"{report.killed} falls when slot {report.killed_at_slot} begins (slots count from 1)"
    table = Table("", flown, "computed, no replan", title=title)
    for row in figures(report):
        table.add_row(*row)
    checks = Table("check against the simulator's ground truth", "", "what was found")
    for check in report.checks:
        checks.add_row(check.name, "[green]yes[/]" if check.passed else "[red]NO[/]", check.detail)
    verdict = Text("passed", style="bold green") if report.passed else Text("FAILED", style="bold red")
    return Group(table, checks, verdict)


def write_page(report: DemoReport, path: Path) -> None:
    """Write one self-contained HTML file: no script, no request."""
    flown = "flown, with replan" if report.replanned else "flown, no replan"
    rows = "".join(
        f"<tr><th scope='row'>{escape(a)}</th><td>{escape(b)}</td><td>{escape(c)}</td></tr>"
        for a, b, c in figures(report)
    )
    checks = "".join(
        f"<tr><th scope='row'>{escape(c.name)}</th><td>{'yes' if c.passed else '<b>NO</b>'}</td>"
        f"<td>{escape(c.detail)}</td></tr>"
        for c in report.checks
    )
    path.write_text(
        "<!doctype html><html lang='en'><head><meta charset='utf-8'>"
        "<meta name='viewport' content='width=device-width'><title>skyfolio drill</title><style>"
        "body{font:15px/1.5 system-ui,sans-serif;max-width:1080px;margin:2em auto;padding:0 1em;color:#1a1a1a}"
        "table{border-collapse:collapse;margin:1em 0}th,td{padding:.3em .9em;border-bottom:1px solid #ccc;"
        "text-align:left;font-weight:400}thead th{font-weight:600}figure{margin:1em 0}svg{max-width:100%;height:auto}"
        "</style></head><body>"
        f"<h1>Drill: {escape(report.killed)} falls when slot {report.killed_at_slot} begins</h1>"
        f"<p><b>{'Passed' if report.passed else 'Failed'}.</b> Flown by a simulated fleet at {report.speedup:g} times "
        f"real time; slots count from 1. Rates are what users truly got at the simulator's true positions.</p>"
        f"<table><thead><tr><td></td><th>{flown}</th><th>computed, no replan</th></tr></thead>{rows}</table>"
        f"<figure>{_map(report)}<figcaption>Planned (dashed) and truly flown (solid) tracks; users as squares."
        f"</figcaption></figure><figure>{_rates(report)}<figcaption>Sum rate in each slot, and below it each user's."
        f"</figcaption></figure><table><thead><tr><th>check</th><th></th><th>found</th></tr></thead>{checks}</table>"
        "</body></html>",
        encoding="utf-8",
    )


def _map(report: DemoReport) -> str:
    figure = new_figure(7.2, 6.6)
    axes = figure.add_subplot()
    scenario = report.plans[0].scenario
    (west, south), (east, north) = scenario.area_m
    axes.set(xlim=(west, east), ylim=(south, north), aspect="equal", xlabel="east, m", ylabel="north, m")
    axes.grid(alpha=0.3)
    users = np.array([user.position_m for user in scenario.users])
    axes.plot(*users.T, "s", color="#555", markersize=5, label="users")
    for number, uav in enumerate(scenario.uav_ids):
        colour = COLOURS[number % len(COLOURS)]
        for plan in report.plans:
            if uav in plan.trajectories_m:
                axes.plot(*np.array(plan.trajectories_m[uav]).T, "--", color=colour, linewidth=1, alpha=0.8)
        track = np.array(report.tracks_m[uav])
        if len(track):
            axes.plot(track[:, 1], track[:, 2], color=colour, linewidth=2, label=uav)
            axes.plot(*track[0, 1:], "o", color=colour, markersize=6)
            if uav == report.killed:
                axes.plot(*track[-1, 1:], "x", color=colour, markersize=12, markeredgewidth=3)
    axes.legend(loc="upper right")
    return as_svg(figure)


def _rates(report: DemoReport) -> str:
    figure = new_figure(9, 6.4)
    top, bottom = figure.subplots(2, 1, sharex=True)
    slots = np.arange(1, len(report.flown.sum_rate_bps) + 1)
    flown = "flown, with replan" if report.replanned else "flown, no replan"
    top.step(slots, np.array(report.flown.sum_rate_bps) / 1e3, where="post", color=COLOURS[0], label=flown)
    top.step(
        slots,
        np.array(report.no_replan.sum_rate_bps) / 1e3,
        "--",
        where="post",
        color=COLOURS[1],
        label="computed, no replan",
    )
    for user, rates in report.flown.user_rates_bps.items():
        if max(rates) > 0:
            bottom.step(slots, np.array(rates) / 1e3, where="post", label=user)
    for axes, label in ((top, "sum rate, kbit/s"), (bottom, "user rates, kbit/s")):
        axes.axvline(report.killed_at_slot, color="#c00", linewidth=1)
        axes.set_ylabel(label)
        axes.set_ylim(bottom=0)
        axes.grid(alpha=0.3)
        axes.legend(loc="lower left", fontsize="small", ncols=3)
    bottom.set_xlabel("slot")
    return as_svg(figure)
