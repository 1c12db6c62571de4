"""The drill's result: a table in the terminal, and one self-contained HTML page."""

from __future__ import annotations

from collections.abc import Callable
from html import escape
from pathlib import Path

from rich.console import Group
from rich.table import Table
from rich.text import Text

from skyfolio.api.lab.demo.charts import service, tracks
from skyfolio.api.lab.demo.report import DemoReport, Rates


def headline(report: DemoReport) -> str:
    """One sentence: who lost service, for how long, and what it would have been."""
    slot_s = report.plans[0].scenario.slot_duration_s
    fell = f"{report.killed} fell in slot {report.killed_at_slot}"
    lost = report.no_replan.unserved_after
    to_the_end_s = len(report.no_replan.sum_rate_bps) * slot_s - report.killed_at_s
    if not lost:
        return f"{fell}, and nobody would have lost service to the end."
    who = lost[0] if len(lost) == 1 else f"{', '.join(lost[:-1])} and {lost[-1]}"
    if report.new_plan_in_force_at_s is None:
        return f"{fell}: {who} had no service for the {to_the_end_s:.0f} s that were left."
    outage_s = report.slots_without_service * slot_s
    still = report.flown.unserved_after
    after = f"; {', '.join(still)} stayed without it" if still else ""
    return (
        f"{fell}: {who} had no service for {outage_s:.1f} s, until others served them; without that it would "
        f"have been {to_the_end_s:.0f} s, to the end{after}."
    )


def figures(report: DemoReport) -> list[tuple[str, str, str, str]]:
    """Rows of the result table: what, flown, no replan, known beforehand; service first, then the letter's measures."""
    flown, without, known = report.flown, report.no_replan, report.foreseen

    def kbps(value: float | None) -> str:
        return "-" if value is None else f"{value / 1e3:.1f} kbit/s"

    def unit(value: float | None, form: str) -> str:
        return "-" if value is None else form.format(value)

    left = len(without.sum_rate_bps) - report.killed_at_slot + 1

    def each(name: str, form: Callable[[Rates], str]) -> tuple[str, str, str, str]:
        return (name, form(flown), form(without), form(known))

    return [
        ("rates of users", rates_from(report), "computed", "computed"),
        each("users without service after", lambda one: _named(one.unserved_after)),
        each("worst user's mean rate after", lambda one: kbps(one.worst_user_after_bps)),
        ("slots without service of the lost UAV's users", f"{report.slots_without_service:.1f}", f"{left:.1f}", "0.0"),
        ("loss declared after", unit(report.detection_s, "{:.2f} s"), "-", "-"),
        ("replan solved in", unit(report.replan_ms, "{:.0f} ms"), "-", "-"),
        ("missions uploaded, verified, flying in", unit(report.upload_s, "{:.3f} s"), "-", "-"),
        each(f"utility ({report.utility.kind}) of all slots", lambda one: kbps(one.utility_bps)),
        each("sum rate before", lambda one: kbps(one.mean_sum_rate_before_bps)),
        each("sum rate during the outage", lambda one: kbps(one.mean_sum_rate_during_bps)),
        each("sum rate after", lambda one: kbps(one.mean_sum_rate_after_bps)),
        each("variance of the sum rate", lambda one: f"{one.sum_rate_variance_kbps2:.1f} (kbit/s)²"),
        each("Jain index of the users", lambda one: f"{one.jain:.3f}"),
    ]


def rates_from(report: DemoReport) -> str:
    """Return in words whether the rates of users in the flight were measured."""
    share = len(report.measured_slots) / len(report.flown.sum_rate_bps)
    if share == 0.0:
        return "computed at true positions"
    return "measured" if share == 1.0 else f"{share:.0%} measured, the rest computed at true positions"


def _named(users: list[str]) -> str:
    return f"{len(users)} ({', '.join(users)})" if users else "none"


def result_table(report: DemoReport) -> Group:
    """Return the table, the checks, and the verdict."""
    flown = "flown, with replan" if report.replanned else "flown, no replan"
    title = f"{report.killed} falls when slot {report.killed_at_slot} begins (slots count from 1)"
    table = Table("", flown, "computed, no replan", "computed, known beforehand", title=title)
    for row in figures(report):
        table.add_row(*row)
    checks = Table("check against the simulator's ground truth", "", "what was found")
    for check in report.checks:
        checks.add_row(check.name, "[green]yes[/]" if check.passed else "[red]NO[/]", check.detail)
    verdict = Text("passed", style="bold green") if report.passed else Text("FAILED", style="bold red")
    return Group(Text(headline(report), style="bold"), table, checks, verdict)


def write_page(report: DemoReport, path: Path) -> None:
    """Write one self-contained HTML file: no script, no request."""
    flown = "flown, with replan" if report.replanned else "flown, no replan"
    rows = "".join(
        f"<tr><th scope='row'>{escape(a)}</th><td>{escape(b)}</td><td>{escape(c)}</td><td>{escape(d)}</td></tr>"
        for a, b, c, d in figures(report)
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
        f"<p><b>{escape(headline(report))}</b></p>"
        f"<p><b>{'Passed' if report.passed else 'Failed'}.</b> Flown by a simulated fleet at {report.speedup:g} times "
        f"real time; slots count from 1. Rates in flight are what users truly got: {rates_from(report)}.</p>"
        f"<figure>{service(report)}<figcaption>In each slot: users served, the worst user's rate, the sum rate. UAVs "
        "that serve everybody carry less in sum than the same UAVs if they leave the lost one's users without service; "
        "the variance of the sum rate counts that as a fluctuation.</figcaption>"
        f"</figure><table><thead><tr><td></td><th>{flown}</th><th>computed, no replan</th>"
        f"<th>computed, known beforehand</th></tr></thead>{rows}</table>"
        f"<figure>{tracks(report)}<figcaption>Where UAVs truly flew, from the ring to the triangle: thin before the "
        "loss, thick after it, dashed as planned. A user with a rim was served by the lost UAV.</figcaption></figure>"
        f"<table><thead><tr><th>check</th><th></th><th>found</th></tr></thead>{checks}</table>"
        "</body></html>",
        encoding="utf-8",
    )
