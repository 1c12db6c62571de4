"""Recoveries as steps with durations, from the journal's entries and the final report. Pure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import Any

from skyfolio.api.dashboard.changes import of_report
from skyfolio.api.dashboard.views import Recovery, Step

Json = Mapping[str, Any]
NAMES = {
    "detected": "Loss detected",
    "classified": "Classified",
    "waiting": "Waiting for positions",
    "replanned": "Replan",
    "checked": "Checked",
    "refused": "Plan refused",
    "proposed": "Waiting for your approval",
    "approved": "Approved",
    "uploading": "Upload",
    "verified": "Verified on board",
    "flying": "Flying the new plan",
    "closed": "Closed",
}
ENDINGS = {
    "flying": "survivors fly the new plan",
    "partly_flying": "not every survivor flies the new plan",
    "too_late": "too late to fly differently",
    "declined": "declined: the plan in force stays",
    "superseded": "superseded by another change",
    "interrupted": "interrupted by a restart",
    "unanswered": "no recovery: the operation ended before",
    "failed": "failed: the plan in force stays",
}
PHASES = {
    "recovering": "recovery in progress",
    "proposed": "a replan waits for your approval",
    "unanswered": "no recovery: the operation ended before",
}
GOOD = {"flying", "declined", "superseded"}
TAKES_TIME = {"waiting", "replanned", "checked", "proposed", "uploading", "verified"}


def recoveries(
    reports: Sequence[Json], journal: Sequence[Json], proposal: Json | None, *, over: bool = False
) -> list[Recovery]:
    """Return one recovery for each incident, the oldest first, including the one in progress.

    Args:
        reports: The operation's `recoveries`: reports of those that are over.
        journal: The operation's journal.
        proposal: The replan that waits for approval, if there is one.
        over: Whether the operation has ended: a recovery that is not over by then never will be.
    """
    by_incident = {int(report["incident"]): report for report in reports}
    entries: dict[int, list[Json]] = {}
    for entry in journal:
        entries.setdefault(int(entry["incident"]), []).append(entry)
    return [
        _recovery(number, entries.get(number, []), by_incident.get(number), proposal, over=over)
        for number in sorted({*by_incident, *entries})
    ]


def _recovery(number: int, entries: list[Json], report: Json | None, proposal: Json | None, *, over: bool) -> Recovery:
    proposed = report is None and proposal is not None and proposal["incident"] == number
    detected = next((entry for entry in entries if entry["step"] == "detected"), None)
    about: Json = report or (detected["data"] if detected else {})
    phase = str(report["outcome"]) if report else "proposed" if proposed else "unanswered" if over else "recovering"
    planned = [entry["data"]["plan_id"] for entry in entries if entry["data"].get("plan_id")]
    return Recovery(
        number=number,
        lost=about.get("lost", {}),
        phase=phase,
        title=f"{', '.join(about.get('lost', {})) or 'Change'}: {PHASES.get(phase) or ENDINGS.get(phase, phase)}",
        at_slot=report["at_slot"] if report else None,
        declared_at_s=report["declared_at_s"] if report else detected["elapsed_s"] if detected else None,
        in_force_at_s=report["in_force_at_s"] if report else None,
        plan_id=report["plan_id"] if report else planned[-1] if planned else None,
        proposed=proposed,
        steps=tuple(_steps(entries, report, over=over)),
        changes=of_report(report) if report else (),
        vehicles=report["vehicles"] if report else {},
        error=report["error"] if report else None,
    )


def _steps(entries: list[Json], report: Json | None, *, over: bool) -> list[Step]:
    groups: list[list[Json]] = []
    for entry in entries:
        same = next((group for group in groups if group[0]["step"] == entry["step"] and entry["uav_id"]), None)
        if same:
            same.append(entry)
        else:
            groups.append([entry])
    steps = []
    for index, group in enumerate(groups):
        if group[0]["step"] == "closed":
            break
        following = groups[index + 1] if index + 1 < len(groups) else None
        steps.append(_step(group, following, over=over or report is not None))
    if report is not None:
        outcome = str(report["outcome"])
        detail = "" if report["error"] is None else str(report["error"])
        took = _total(entries)
        state = "done" if outcome in GOOD else "failed"
        steps.append(Step(name=ENDINGS.get(outcome, outcome).capitalize(), took=took, detail=detail, state=state))
    elif over and steps:
        steps.append(Step(name="The operation ended before the recovery", state="failed"))
    return steps


def _step(group: list[Json], following: list[Json] | None, *, over: bool) -> Step:
    kind = str(group[0]["step"])
    active = following is None and not over
    state = "active" if active else "failed" if kind == "refused" else "done"
    if active and kind == "proposed":
        state = "waiting"
    took = ""
    if following is not None and kind in TAKES_TIME:
        took = _span(_at(group[0]), _at(following[0]))
    return Step(name=NAMES.get(kind, kind), took=took, detail=_detail(kind, group), state=state)


def _detail(kind: str, group: list[Json]) -> str:
    data: Json = group[0]["data"]
    if kind == "detected":
        return ", ".join(f"{uav}, {silent_s:.1f} s silent" for uav, silent_s in data.get("lost", {}).items())
    if kind == "classified":
        return ", ".join(f"{uav}: {_words(seen.get('verdict'))}" for uav, seen in data.get("evidence", {}).items())
    if kind == "replanned":
        return f"from slot {data.get('at_slot')}, attempt {data.get('attempt')}"
    if kind == "checked":
        solved = "" if data.get("replan_ms") is None else f", solved in {data['replan_ms']:.0f} ms"
        return f"{data.get('plan_id')}, {_words(data.get('source'))}{solved}"
    if kind in {"uploading", "verified"}:
        return ", ".join(str(entry["uav_id"]) for entry in group if entry["uav_id"])
    return str(data.get("error") or data.get("plan_id") or "")


def _total(entries: list[Json]) -> str:
    return f"{_span(_at(entries[0]), _at(entries[-1]))} in all" if len(entries) > 1 else ""


def _at(entry: Json) -> datetime:
    return datetime.fromisoformat(str(entry["at"]))


def _span(begin: datetime, end: datetime) -> str:
    seconds = (end - begin).total_seconds()
    return f"{seconds:.1f} s" if seconds >= 10 else f"{seconds * 1e3:.0f} ms"


def _words(value: object) -> str:
    return "" if value is None else str(value).replace("_", " ")
