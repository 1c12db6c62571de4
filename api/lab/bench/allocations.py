"""What the radio half of an operation gains: a channel corrected in flight, and users served at once after a loss.

The whole service flies a simulated fleet with base stations in virtual time, so that no figure depends on the machine;
what users get is the simulator's ground truth.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from rich.table import Table

from skyfolio import sim
from skyfolio.api.flights.base_stations import assumed_by
from skyfolio.api.flights.rates import InForce
from skyfolio.api.lab.bench.radio_flight import Case, Flown, fly
from skyfolio.api.lab.bench.tables import Lines, grid, on_terminal
from skyfolio.planner import EXAMPLES, Plan, Utility

Row: TypeAlias = dict[str, Any]
SERVED_BPS = 1.0
"""A user that gets less has no service."""
LOST = "uav-3"
UTILITY = Utility(kind="pooled", mu_per_kbps=-0.1)
"""Under it all users are served, as in the demo."""


# -- a wrong channel --------------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class WrongChannel:
    """A channel that the planner does not know. noise_dbm: of the scenario; None is the letter's."""

    name: str
    noise_dbm: float | None = None
    bias_db: float = 0.0
    shadowing_db: float = 0.0
    fading: bool = False


WRONG = (
    WrongChannel(name="all links 6 dB worse", bias_db=-6.0),
    WrongChannel(name="each link of its own, 6 dB standard deviation", shadowing_db=6.0),
    WrongChannel(name="all 6 dB worse, each of its own, 4 dB", bias_db=-6.0, shadowing_db=4.0),
    WrongChannel(name="all 6 dB worse, much noise", noise_dbm=-45.0, bias_db=-6.0),
    WrongChannel(
        name="all 6 dB worse, each of its own, 4 dB, much noise", noise_dbm=-45.0, bias_db=-6.0, shadowing_db=4.0
    ),
    WrongChannel(name="the same, with fading", noise_dbm=-45.0, bias_db=-6.0, shadowing_db=4.0, fading=True),
)
LEARNT_BY_SLOT = 5


def wrong_channel_row(wrong: WrongChannel, seeds: Sequence[int]) -> Row:
    """Return planned and achieved sum rates from slot LEARNT_BY_SLOT on, with correction and without, over seeds."""
    row: Row = {"channel": wrong.name}
    for name, report in (("corrected", True), ("uncorrected", False)):
        flown = [fly(_wrong_case(wrong, seed, report=report)) for seed in seeds]
        planned, achieved = np.array([_planned_and_achieved_kbps(one) for one in flown]).T
        row[name] = {
            "planned_kbps": float(planned.mean()),
            "achieved_kbps": float(achieved.mean()),
            "off_percent": float(np.mean(100.0 * np.abs(achieved / planned - 1.0))),
            "most_off_percent": float(np.max(100.0 * np.abs(achieved / planned - 1.0))),
            "replans": float(np.mean([len(one.view.recoveries) for one in flown])),
        }
    return row


def _wrong_case(wrong: WrongChannel, seed: int, *, report: bool) -> Case:
    scenario = EXAMPLES["paper"]().with_changes(utility=UTILITY)
    if wrong.noise_dbm is not None:
        noisy = scenario.channel.model_copy(update={"noise_dbm": wrong.noise_dbm})
        scenario = scenario.with_changes(channel=noisy)
    drawn = sim.TruthChannel(
        bias_db=wrong.bias_db,
        shadowing_db=wrong.shadowing_db,
        rician_k_db=scenario.channel.rician_k_db if wrong.fading else None,
        seed=seed,
    )
    channel = assumed_by(scenario, drawn)
    return Case(scenario=scenario, channel=channel, report=report, seed=seed)


def _planned_and_achieved_kbps(flown: Flown) -> tuple[float, float]:
    """Return the mean sum rate that the plans in force promised from slot LEARNT_BY_SLOT on, and what users got."""
    plan = flown.serving[0].plan
    slot_s, last_s = plan.scenario.slot_duration_s, plan.scenario.slots * plan.scenario.slot_duration_s
    planned, achieved = [], []
    for at_s, rates in flown.rates_bps:
        if LEARNT_BY_SLOT * slot_s <= at_s < last_s:
            planned.append(_promised_bps(flown.serving, at_s, slot_s))
            achieved.append(sum(rates.values()))
    return float(np.mean(planned)) / 1e3, float(np.mean(achieved)) / 1e3


def _promised_bps(serving: Sequence[InForce], at_s: float, slot_s: float) -> float:
    plan = [entry for entry in serving if entry.from_s <= at_s][-1].plan
    n = min(max(int(at_s // slot_s) - plan.first_slot, 0), plan.scenario.slots - 1)
    return sum(row[n] for row in plan.user_rates_bps.values())


# -- a loss -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Situation:
    """In which a UAV is lost."""

    name: str
    link: sim.Impairments | None = None
    approve_after_s: float | None = None


SITUATIONS = (
    Situation(name="perfect links"),
    Situation(name="slow links (0.3 s each way, 10 % lost)", link=sim.Impairments(latency_s=0.3, loss=0.1)),
    Situation(name="the operator approves after 10 s", approve_after_s=10.0),
)


def loss_row(situation: Situation, seeds: Sequence[int]) -> Row:
    """Return the slots in which users of the lost UAV had no service after the loss was declared, over seeds."""
    row: Row = {"situation": situation.name}
    for name, reassociate in (("at_once", True), ("with_the_new_plan", False)):
        gaps = [gap for seed in seeds for gap in _gaps(_loss_case(situation, seed, reassociate=reassociate))]
        row[name] = {
            "mean_slots": float(np.mean([gap for gap, _ in gaps])),
            "most_slots": float(np.max([gap for gap, _ in gaps])),
            "detection_slots": float(np.mean([detection for _, detection in gaps])),
        }
    return row


def _loss_case(situation: Situation, seed: int, *, reassociate: bool) -> Flown:
    scenario = EXAMPLES["paper"]().with_changes(utility=UTILITY)
    return fly(
        Case(
            scenario=scenario,
            reassociate=reassociate,
            loses=LOST,
            link=situation.link,
            approve_after_s=situation.approve_after_s,
            seed=seed,
        )
    )


def _gaps(flown: Flown) -> list[tuple[float, float]]:
    """Return for each user of the lost UAV how many slots it had no service beyond detection, and detection itself."""
    plan = flown.serving[0].plan
    slot_s = plan.scenario.slot_duration_s
    declared_s = flown.view.recoveries[0].declared_at_s
    users = _served_by(plan, LOST, int(flown.struck_s // slot_s))
    end_s = plan.scenario.slots * slot_s
    gaps = []
    for user in users:
        again = (at for at, rates in flown.rates_bps if at >= declared_s and rates.get(user, 0.0) >= SERVED_BPS)
        gaps.append(((next(again, end_s) - declared_s) / slot_s, (declared_s - flown.struck_s) / slot_s))
    return gaps


def _served_by(plan: Plan, uav: str, slot: int) -> list[str]:
    return [user for user, row in plan.bandwidth_hz.items() if row[slot] > 0 and plan.association[user][slot] == uav]


# -- all of it --------------------------------------------------------------------------------------------------------


def allocation_figures(
    seeds: int,
    *,
    wrong: Sequence[WrongChannel] = WRONG,
    situations: Sequence[Situation] = SITUATIONS,
    told: Callable[[Row], None] = lambda row: None,  # noqa: ARG005
) -> Row:
    """Return all figures, over so many seeds of the shadowing and of the fleet; `told` is called with each row."""
    chosen = range(1, seeds + 1)
    figures: Row = {"seeds": seeds, "wrong_channel": [], "loss": []}
    for channel in wrong:
        figures["wrong_channel"].append(wrong_channel_row(channel, chosen))
        told(figures["wrong_channel"][-1])
    for situation in situations:
        figures["loss"].append(loss_row(situation, chosen))
        told(figures["loss"][-1])
    return figures


def tables(figures: Row) -> list[Table]:
    """Return the figures as tables for a terminal."""
    return [on_terminal(title, lines) for title, lines in _lines(figures)]


def markdown(figures: Row) -> str:
    """Return the figures as a page."""
    about = (
        "Written by `skyfolio bench allocations --page`; do not edit. The whole service flies the letter's scenario "
        "under `pooled`, mu = -0.1, in virtual time, with simulated base stations whose true channel the planner does "
        f"not know; {figures['seeds']} seeds each. [radio.md](../radio.md) says how it works."
    )
    said = ["# The radio half of an operation", "", about]
    for title, lines in _lines(figures):
        said += ["", f"## {title}", "", grid(lines)]
    return "\n".join(said) + "\n"


def _lines(figures: Row) -> list[tuple[str, Lines]]:
    measured = ["planned", "achieved", "off by", "at most"]
    wrong = [["true channel", *measured, "replans", *(f"uncorrected: {name}" for name in measured)]]
    for row in figures["wrong_channel"]:
        learnt, not_learnt = row["corrected"], row["uncorrected"]
        wrong.append([row["channel"], *_rates(learnt), f"{learnt['replans']:.1f}", *_rates(not_learnt)])
    loss = [["situation", "at once: mean", "most", "with the new plan: mean", "most", "detection"]]
    for row in figures["loss"]:
        named = [(name, key) for name in ("at_once", "with_the_new_plan") for key in ("mean_slots", "most_slots")]
        cells = [f"{row[name][key]:.2f}" for name, key in named]
        loss.append([row["situation"], *cells, f"{row['at_once']['detection_slots']:.2f}"])
    return [
        (f"Mean sum rate from slot {LEARNT_BY_SLOT} on, kbit/s", wrong),
        ("Slots without service after a loss was declared, of the users of the lost UAV", loss),
    ]


def _rates(row: Row) -> list[str]:
    return [
        *(f"{row[key]:.1f}" for key in ("planned_kbps", "achieved_kbps")),
        *(f"{row[key]:.1f} %" for key in ("off_percent", "most_off_percent")),
    ]
