"""The drill's pictures: where everybody flew, and who was served how well."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from skyfolio.api.lab.demo.report import DemoReport, Rates
from skyfolio.api.lab.plots import as_svg, new_figure
from skyfolio.planner import Plan
from skyfolio.planner.arrays import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#f0e442")
"""Okabe and Ito's palette: distinguishable with colour blindness too."""
SERVED_BPS = 1e3
"""A user that gets less over a slot is not served in it: the moments before its UAV fell are no service."""


def tracks(report: DemoReport) -> str:
    """Return the map as SVG: true tracks, thick from the loss on, with users in the colour of the UAV that serves them.

    A user that the lost UAV served has a rim in that UAV's colour; dashed is what was planned.
    """
    figure = new_figure(7.6, 6.8)
    axes = figure.add_subplot()
    scenario = report.plans[0].scenario
    (west, south), (east, north) = scenario.area_m
    axes.set(xlim=(west, east), ylim=(south, north), aspect="equal", xlabel="east, m", ylabel="north, m")
    axes.grid(alpha=0.3)
    colours = {uav: COLOURS[number % len(COLOURS)] for number, uav in enumerate(scenario.uav_ids)}
    for uav, colour in colours.items():
        for plan in report.plans:
            if uav in plan.trajectories_m:
                axes.plot(*np.array(plan.trajectories_m[uav]).T, "--", color=colour, linewidth=1, alpha=0.8)
        _draw_track(axes, report, uav, colour)
    for user in scenario.users:
        before, after = (_server(plan, user.id) for plan in (report.plans[0], report.plans[-1]))
        rim = colours[report.killed] if before == report.killed else "white"
        axes.plot(*user.position_m, "s", color=colours[after], markersize=9, markeredgecolor=rim, markeredgewidth=2)
    axes.plot([], [], "s", color="#777", markersize=7, label="user, in the colour of its UAV at the end")
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.1), ncols=2, fontsize="small", frameon=False)
    return as_svg(figure)


def _draw_track(axes: Axes, report: DemoReport, uav: str, colour: str) -> None:
    track = np.array(report.tracks_m[uav])
    if not len(track):
        return
    before, after = track[track[:, 0] <= report.killed_at_s], track[track[:, 0] >= report.killed_at_s]
    axes.plot(before[:, 1], before[:, 2], color=colour, linewidth=1.6, alpha=0.7)
    axes.plot(*track[0, 1:], "o", color=colour, markersize=6, markerfacecolor="white")
    if uav == report.killed:
        axes.plot(*track[-1, 1:], "x", color=colour, markersize=14, markeredgewidth=4, label=f"{uav}, lost here")
        return
    axes.plot(after[:, 1], after[:, 2], color=colour, linewidth=3.2, label=f"{uav}, thick after the loss")
    axes.plot(*track[-1, 1:], "^", color=colour, markersize=12, markeredgecolor="black")


def _server(plan: Plan, user: str) -> str:
    """Return the UAV that serves the user when the plan ends."""
    return plan.association[user][-1]


def service(report: DemoReport) -> str:
    """Three panels over the slots, as SVG: users served, the worst user's rate, and the sum rate.

    Each shows what was flown, and what no replan and knowing of the loss from the start would have given.
    """
    figure = new_figure(9, 7.6)
    panels = figure.subplots(3, 1, sharex=True)
    flown = "flown, with replan" if report.replanned else "flown, no replan"
    courses = (
        (flown, report.flown, "-", 2.2),
        ("computed, no replan", report.no_replan, "--", 1.4),
        ("computed, known beforehand", report.foreseen, ":", 1.4),
    )
    for number, (label, rates, style, width) in enumerate(courses):
        look = {"linestyle": style, "linewidth": width, "color": COLOURS[number], "label": label}
        for axes, values in zip(panels, by_slot(rates), strict=True):
            axes.step(np.arange(1, len(values) + 2), np.append(values, values[-1]), where="post", **look)
    titles = ("users served", "worst user, kbit/s", "sum rate, kbit/s")
    for axes, title in zip(panels, titles, strict=True):
        _finish(axes, title, report)
    panels[0].set_ylim(top=len(report.flown.user_rates_bps) + 0.5)
    panels[0].legend(loc="lower left", fontsize="small")
    n_slots = len(report.flown.sum_rate_bps)
    panels[-1].set(xlabel="slot", xlim=(1, n_slots + 1), xticks=np.arange(1, n_slots + 1))
    panels[0].set_title(f"{report.killed} falls; shaded until a new plan is flown", fontsize="medium", loc="right")
    return as_svg(figure)


def by_slot(rates: Rates) -> tuple[Array, Array, Array]:
    """In each slot: how many users are served, what the worst of all users gets, and the sum rate; kbit/s."""
    table = np.array(list(rates.user_rates_bps.values()))
    return (table >= SERVED_BPS).sum(axis=0), table.min(axis=0) / 1e3, np.array(rates.sum_rate_bps) / 1e3


def _finish(axes: Axes, title: str, report: DemoReport) -> None:
    """Name a panel, and shade it from the fall until a new plan is in force, or to the end."""
    slot_s, n_slots = report.plans[0].scenario.slot_duration_s, len(report.flown.sum_rate_bps)
    recovered_s = report.new_plan_in_force_at_s
    until = n_slots + 1 if recovered_s is None else recovered_s / slot_s + 1
    axes.axvspan(report.killed_at_s / slot_s + 1, until, color="#c00", alpha=0.12, linewidth=0)
    axes.axvline(report.killed_at_slot, color="#c00", linewidth=1)
    axes.set_ylabel(title)
    axes.set_ylim(bottom=0)
    axes.grid(alpha=0.3)
