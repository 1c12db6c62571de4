"""The drill's pictures: where everybody flew, and who was served how well."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from skyfolio.api.lab.demo.report import DemoReport, Rates
from skyfolio.api.lab.plots import as_svg, new_figure
from skyfolio.planner.arrays import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#f0e442")
"""Okabe and Ito's palette: distinguishable with colour blindness too."""
SERVED_BPS = 1e3
"""A user that gets less over a slot is not served in it: the moments before its UAV fell are no service."""


def tracks(report: DemoReport) -> str:
    """Return the map as SVG: planned and truly flown tracks, users, and where the lost UAV fell."""
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
            axes.step(np.arange(1, len(values) + 1), values, where="post", **look)
    titles = ("users served", "worst user, kbit/s", "sum rate, kbit/s")
    for axes, title in zip(panels, titles, strict=True):
        _finish(axes, title, report.killed_at_slot)
    panels[0].set_ylim(top=len(report.flown.user_rates_bps) + 0.5)
    panels[0].legend(loc="lower left", fontsize="small")
    panels[-1].set_xlabel("slot")
    return as_svg(figure)


def by_slot(rates: Rates) -> tuple[Array, Array, Array]:
    """In each slot: how many users are served, what the worst of all users gets, and the sum rate; kbit/s."""
    table = np.array(list(rates.user_rates_bps.values()))
    return (table >= SERVED_BPS).sum(axis=0), table.min(axis=0) / 1e3, np.array(rates.sum_rate_bps) / 1e3


def _finish(axes: Axes, title: str, killed_at_slot: int) -> None:
    axes.axvline(killed_at_slot, color="#c00", linewidth=1)
    axes.set_ylabel(title)
    axes.set_ylim(bottom=0)
    axes.grid(alpha=0.3)
