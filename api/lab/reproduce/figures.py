"""The letter's figures, drawn from the study's numbers. Each function returns a matplotlib figure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from skyfolio.api.lab.plots import COLOURS, MARKERS, new_figure
from skyfolio.api.lab.reproduce.courses import FAILURE_SLOT

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def convergence(histories: Mapping[str, Mapping[str, Sequence[float]]]) -> Figure:
    """Draw fig. 2: utility and mean sum rate after each iteration, for several mu; kbit/s."""
    figure = new_figure(9, 3.6)
    for axes, what in zip(figure.subplots(1, 2), ("utility", "sum rate"), strict=True):
        for index, (mu, history) in enumerate(histories.items()):
            values = history["utility_kbps" if what == "utility" else "sum_rate_kbps"]
            axes.plot(range(1, len(values) + 1), values, color=COLOURS[index], marker=MARKERS[index], label=f"µ = {mu}")
        axes.set(xlabel="iteration", ylabel=f"{what}, kbit/s")
        _finish(axes)
    return figure


def periods(curves: Mapping[str, Sequence[float]], title: str) -> Figure:
    """Draw fig. 3: the sum rate of each slot, and its average over each ten slots as a solid line; kbit/s."""
    figure = new_figure(9, 4.6)
    axes = figure.add_subplot()
    for index, (name, values) in enumerate(curves.items()):
        colour, slots = COLOURS[index % len(COLOURS)], np.arange(1, len(values) + 1)
        axes.plot(
            slots, values, marker=MARKERS[index % len(MARKERS)], color=colour, linestyle=":", label=name, alpha=0.7
        )
        for begin in range(0, len(values), FAILURE_SLOT):
            part = slice(begin, begin + FAILURE_SLOT)
            axes.plot(slots[part], np.full(len(slots[part]), np.mean(values[part])), color=colour, linewidth=2)
    axes.axvline(FAILURE_SLOT + 1, color="#c00", linewidth=1)
    axes.set(xlabel="slot", ylabel="sum rate, kbit/s", title=title)
    _finish(axes)
    return figure


def against_mu(
    mus: Sequence[float],
    curves: Mapping[str, tuple[Sequence[float], Sequence[float]]],
    levels: Mapping[str, float],
    label: str,
) -> Figure:
    """Draw fig. 5: a measure against |mu| (mean and its interval); baselines and the letter's numbers as levels."""
    figure = new_figure(7, 4.2)
    axes = figure.add_subplot()
    strength = np.abs(np.array(mus))
    for index, (name, (mean, interval)) in enumerate(curves.items()):
        centre, half = np.array(mean), np.array(interval)
        axes.plot(strength, centre, color=COLOURS[index], marker=MARKERS[index], label=name)
        axes.fill_between(strength, centre - half, centre + half, color=COLOURS[index], alpha=0.12, linewidth=0)
    for index, (name, value) in enumerate(levels.items()):
        axes.axhline(value, color=COLOURS[(len(curves) + index) % len(COLOURS)], linestyle="--", label=name)
    axes.set(xscale="log", xlabel="|µ|, 1/(kbit/s)", ylabel=label)
    _finish(axes)
    return figure


def trade_off(rows: Sequence[Mapping[str, float]], chosen_mu: float | None) -> Figure:
    """Draw sum rate, variance and Jain index against |mu|, and the chosen mu."""
    figure = new_figure(10, 3.4)
    strength = [abs(row["mu_per_kbps"]) for row in rows]
    panels = (
        ("mean_sum_rate_kbps", "sum rate, kbit/s"),
        ("variance_kbps2", "variance, (kbit/s)²"),
        ("jain", "Jain index"),
    )
    for index, (axes, (key, label)) in enumerate(zip(figure.subplots(1, 3), panels, strict=True)):
        axes.plot(strength, [row[key] for row in rows], color=COLOURS[index], marker="o", markersize=4)
        if chosen_mu is not None:
            axes.axvline(abs(chosen_mu), color="#c00", linewidth=1, label=f"µ = {chosen_mu:.3g}")
            axes.legend(fontsize="small")
        axes.set(xscale="log", xlabel="|µ|, 1/(kbit/s)", ylabel=label)
        axes.grid(alpha=0.3)
    return figure


def _finish(axes: Axes) -> None:
    axes.grid(alpha=0.3)
    axes.legend(fontsize="x-small", ncols=2)
