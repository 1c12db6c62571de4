"""The figures of a drill, from what the service recorded. Pure. Times `_s` are fleet seconds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from skyfolio.api.dashboard.comparison import without
from skyfolio.api.dashboard.measured import source_words
from skyfolio.api.dashboard.views import Drill, Operation, TrackPoint
from skyfolio.planner import Plan
from skyfolio.planner.utility import jain_index

Rate = float | None


@dataclass(frozen=True)
class Report:
    """The report as it is shown and saved. Rows are (name, flown, without a recovery); rates per slot are in bit/s."""

    operation_id: str
    title: str
    verdict: str
    recovered: bool
    head: tuple[str, ...]
    rows: list[tuple[str, ...]]
    plans: list[Plan]
    lost_at_slot: dict[str, float]
    flown: list[Rate]
    without_recovery: list[Rate]
    users: dict[str, list[Rate]]
    tracks_m: dict[str, list[tuple[float, float]]]
    steps: list[tuple[str, str, str]] = field(default_factory=list)


def report_of(operation: Operation, plans: Sequence[Plan], track: Sequence[TrackPoint], drill: Drill | None) -> Report:
    """Judge an operation that has ended; `plans` are in the order in which they came into force."""
    first = plans[0]
    n, slot_s = first.scenario.slots, first.scenario.slot_duration_s
    lost = lost_at(operation, slot_s)
    table = {user: list(operation.user_rates_bps.get(user, [None] * n)) for user in first.scenario.user_ids}
    flown = sums(table, n)
    without_recovery = sums(_without_recovery(first, lost), n)
    first_loss = min(lost.values(), default=float(n))
    in_force_s = [recovery.in_force_at_s for recovery in operation.recoveries if recovery.in_force_at_s is not None]
    resumed_at_slot = in_force_s[0] / slot_s if in_force_s else None
    recovered = operation.state == "completed" and (not lost or resumed_at_slot is not None)
    return Report(
        operation_id=operation.id,
        title=_title(drill, operation),
        verdict=_verdict(operation, lost, recovered=recovered),
        recovered=recovered,
        head=("", "flown", "computed: no recovery"),
        rows=_rows(operation, table, (flown, without_recovery), first_loss, resumed_at_slot),
        plans=list(plans),
        lost_at_slot=lost,
        flown=flown,
        without_recovery=without_recovery,
        users=table,
        tracks_m=_tracks(track),
        steps=[(step.name, step.took, step.detail) for recovery in operation.recoveries for step in recovery.steps],
    )


def lost_at(operation: Operation, slot_s: float) -> dict[str, float]:
    """Return, for each lost UAV, the slot, with fractions, in which it fell silent."""
    found = {}
    for recovery in operation.recoveries:
        for uav, silent_for_s in recovery.lost.items():
            if recovery.declared_at_s is not None:
                found[uav] = max(recovery.declared_at_s - silent_for_s, 0.0) / slot_s
    return found


def sums(table: Mapping[str, Sequence[Rate]], n_slots: int) -> list[Rate]:
    """Return the sum over users in each slot, None where any user's rate is unknown."""
    totals: list[Rate] = []
    for n in range(n_slots):
        column = [row[n] if n < len(row) else None for row in table.values()]
        known = [rate for rate in column if rate is not None]
        totals.append(sum(known) if column and len(known) == len(column) else None)
    return totals


def _without_recovery(first: Plan, lost: Mapping[str, float]) -> dict[str, list[float]]:
    """Return the rates, computed, that users would have got if the survivors had flown the first plan to its end."""
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
    lost_at_slot: float,
    resumed_at_slot: float | None,
) -> list[tuple[str, ...]]:
    flown, unchanged = courses
    n = len(flown)
    first, back = int(lost_at_slot), n if resumed_at_slot is None else min(int(np.ceil(resumed_at_slot)), n)
    rows: list[tuple[str, ...]] = [
        ("sum rate before the loss", _mean(flown[:first]), _mean(unchanged[:first])),
        ("sum rate during the outage", _mean(flown[first:back]), _mean(unchanged[first:back])),
        ("sum rate after the replan", _mean(flown[back:]), _mean(unchanged[back:])),
        ("variance of the sum rate", _variance(flown), _variance(unchanged)),
        ("Jain index of the users", _jain(table), "-"),
        ("rates of users", source_words(table, operation.measured_slots), "-"),
    ]
    for recovery in (one for one in operation.recoveries if one.lost):
        silence = max(recovery.lost.values(), default=0.0)
        rows.append((f"{', '.join(recovery.lost)}: declared after", f"{silence:.2f} s of silence", "-"))
        if recovery.in_force_at_s is not None and recovery.declared_at_s is not None:
            after = recovery.in_force_at_s - recovery.declared_at_s
            rows.append((f"{', '.join(recovery.lost)}: new plan in force after", f"{after:.2f} s", "-"))
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
        return f"The operation was only partly completed: {operation.error}."
    if operation.state != "completed":
        return f"The operation {operation.state}: {operation.error or 'it did not reach its end'}."
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
