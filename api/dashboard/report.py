"""The figures of a drill, from what the service recorded. Pure. Times `_s` are fleet seconds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from skyfolio.api.dashboard.comparison import without
from skyfolio.api.dashboard.views import Drill, Operation, TrackPoint
from skyfolio.planner import Plan
from skyfolio.planner.utility import jain_index

Rate = float | None


@dataclass(frozen=True)
class Report:
    """What is shown and kept. Rows: (what, flown, if nobody had answered). Rates per slot in bit/s."""

    operation_id: str
    title: str
    verdict: str
    recovered: bool
    head: tuple[str, ...]
    rows: list[tuple[str, ...]]
    plans: list[Plan]
    lost_at_slot: dict[str, float]
    flown: list[Rate]
    unanswered: list[Rate]
    users: dict[str, list[Rate]]
    tracks_m: dict[str, list[tuple[float, float]]]
    steps: list[tuple[str, str, str]] = field(default_factory=list)


def report_of(operation: Operation, plans: Sequence[Plan], track: Sequence[TrackPoint], drill: Drill | None) -> Report:
    """Judge an operation that has ended. `plans`: as they came into force, the first one first."""
    first = plans[0]
    n, slot_s = first.scenario.slots, first.scenario.slot_duration_s
    lost = lost_at(operation, slot_s)
    table = {user: list(operation.user_rates_bps.get(user, [None] * n)) for user in first.scenario.user_ids}
    flown = sums(table, n)
    unanswered = sums(_unanswered(first, lost), n)
    begins = min(lost.values(), default=float(n))
    answers = [one for one in operation.recoveries if one.in_force_at_s is not None]
    again = answers[0].in_force_at_s / slot_s if answers and answers[0].in_force_at_s is not None else None
    recovered = operation.state == "completed" and (not lost or again is not None)
    return Report(
        operation_id=operation.id,
        title=_title(drill, operation),
        verdict=_verdict(operation, lost, recovered=recovered),
        recovered=recovered,
        head=("", "flown", "computed: nobody answers"),
        rows=_rows(operation, table, (flown, unanswered), begins, again),
        plans=list(plans),
        lost_at_slot=lost,
        flown=flown,
        unanswered=unanswered,
        users=table,
        tracks_m=_tracks(track),
        steps=[(step.name, step.took, step.detail) for one in operation.recoveries for step in one.steps],
    )


def lost_at(operation: Operation, slot_s: float) -> dict[str, float]:
    """UAV to the slot, with fractions, in which it fell silent."""
    found = {}
    for one in operation.recoveries:
        for uav, silent in one.lost.items():
            if one.declared_at_s is not None:
                found[uav] = max(one.declared_at_s - silent, 0.0) / slot_s
    return found


def sums(table: Mapping[str, Sequence[Rate]], n_slots: int) -> list[Rate]:
    """Sum over users in each slot, None where one is not known."""
    made: list[Rate] = []
    for n in range(n_slots):
        column = [row[n] if n < len(row) else None for row in table.values()]
        known = [rate for rate in column if rate is not None]
        made.append(sum(known) if column and len(known) == len(column) else None)
    return made


def _unanswered(first: Plan, lost: Mapping[str, float]) -> dict[str, list[float]]:
    """What users would have got had the survivors flown the first plan to its end: computed, not flown."""
    rates = {user: list(row) for user, row in first.user_rates_bps.items()}
    for slot in sorted({int(at) for at in lost.values()}):
        gone = [uav for uav, at in lost.items() if int(at) <= slot]
        for user, row in without(first, gone, slot).items():
            rates[user][slot:] = row
    return rates


def _rows(
    operation: Operation,
    table: Mapping[str, Sequence[Rate]],
    courses: tuple[list[Rate], list[Rate]],
    begins: float,
    again: float | None,
) -> list[tuple[str, ...]]:
    flown, silent = courses
    n = len(flown)
    first, back = int(begins), n if again is None else min(int(np.ceil(again)), n)
    rows: list[tuple[str, ...]] = [
        ("sum rate before the loss", _mean(flown[:first]), _mean(silent[:first])),
        ("sum rate during the outage", _mean(flown[first:back]), _mean(silent[first:back])),
        ("sum rate after the replan", _mean(flown[back:]), _mean(silent[back:])),
        ("variance of the sum rate", _variance(flown), _variance(silent)),
        ("Jain index of the users", _jain(table), "-"),
    ]
    for one in operation.recoveries:
        silence = max(one.lost.values(), default=0.0)
        rows.append((f"{', '.join(one.lost)}: declared after", f"{silence:.2f} s of silence", "-"))
        if one.in_force_at_s is not None and one.declared_at_s is not None:
            after = one.in_force_at_s - one.declared_at_s
            rows.append((f"{', '.join(one.lost)}: new plan in force after", f"{after:.2f} s", "-"))
    return rows + [(f"{uav}: at the end", end.replace("_", " "), "-") for uav, end in operation.ends.items()]


def _mean(rates: Sequence[Rate]) -> str:
    known = [rate for rate in rates if rate is not None]
    return f"{float(np.mean(known)) / 1e3:.1f} kbit/s" if known else "-"


def _variance(rates: Sequence[Rate]) -> str:
    known = [rate / 1e3 for rate in rates if rate is not None]
    return f"{float(np.var(known)):.1f} (kbit/s)²" if known else "-"


def _jain(table: Mapping[str, Sequence[Rate]]) -> str:
    means = [np.mean([rate for rate in row if rate is not None] or [0.0]) for row in table.values()]
    return f"{jain_index(np.array(means)[:, None]):.3f}" if any(means) else "-"


def _title(drill: Drill | None, operation: Operation) -> str:
    if drill is None:
        return f"Operation {operation.id}"
    when = "at once" if drill.at_slot is None else f"when slot {drill.at_slot} begins"
    return f"Drill: {drill.fault} of {drill.uav_id} {when}"


def _verdict(operation: Operation, lost: Mapping[str, float], *, recovered: bool) -> str:
    if operation.state == "completed_partly":
        return f"The operation was completed in part only: {operation.error}."
    if operation.state != "completed":
        return f"The operation {operation.state}: {operation.error or 'it did not come to its end'}."
    if not lost:
        return "The operation was completed; no UAV was declared lost."
    names = ", ".join(lost)
    if recovered:
        return f"Recovered: {names} was lost, and the survivors flew a new plan to its end."
    return f"Not recovered: {names} was lost, and the survivors flew the first plan to its end."


def _tracks(track: Sequence[TrackPoint]) -> dict[str, list[tuple[float, float]]]:
    found: dict[str, list[tuple[float, float]]] = {}
    for point in track:
        for uav, at in point.positions_m.items():
            found.setdefault(uav, []).append(at)
    return found
