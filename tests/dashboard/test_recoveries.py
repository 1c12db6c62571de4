"""Recoveries, from the journal and the final report."""

from typing import Any

from skyfolio.api.dashboard.recoveries import recoveries

LOST = {"uav-3": 5.2}


def entry(step: str, second: float, uav_id: str | None = None, incident: int = 1, **data: Any) -> dict[str, Any]:
    at = f"2030-01-01T00:00:{second:06.3f}+00:00"
    return {"incident": incident, "step": step, "uav_id": uav_id, "at": at, "elapsed_s": 50.0 + second, "data": data}


DETECTED = entry("detected", 1.0, cause="heartbeat_lost", lost=LOST)
CLASSIFIED = entry("classified", 1.01, evidence={"uav-3": {"verdict": "heartbeat_lost"}})
REPLANNED = entry("replanned", 1.02, at_slot=12, attempt=1)
CHECKED = entry("checked", 1.12, plan_id="plan-2", source="planned_ahead", replan_ms=80.0)
REPORT = {
    "incident": 1,
    "outcome": "flying",
    "lost": LOST,
    "at_slot": 12,
    "declared_at_s": 51.0,
    "in_force_at_s": 53.0,
    "plan_id": "plan-2",
    "vehicles": {"uav-1": None, "uav-2": None},
    "error": None,
}


def test_a_running_recovery_shows_how_far_it_is() -> None:
    (one,) = recoveries([], [DETECTED, CLASSIFIED, REPLANNED], None)
    assert one.lost == LOST
    assert one.phase == "recovering"
    assert [(step.name, step.state) for step in one.steps] == [
        ("Loss detected", "done"),
        ("Classified", "done"),
        ("Replan", "active"),
    ]
    assert one.steps[0].detail == "uav-3, 5.2 s silent"
    assert one.steps[1].detail == "uav-3: heartbeat lost"


def test_a_proposal_waits_for_the_operator() -> None:
    journal = [DETECTED, REPLANNED, CHECKED, entry("proposed", 1.2, plan_id="plan-2")]
    (one,) = recoveries([], journal, {"incident": 1, "plan_id": "plan-2", "lost": LOST})
    assert one.proposed
    assert one.plan_id == "plan-2"
    assert one.steps[-1].state == "waiting"
    assert "waits for your approval" in one.title


def test_a_finished_recovery_shows_each_step_with_its_time_and_its_vehicles() -> None:
    journal = [
        DETECTED,
        CLASSIFIED,
        REPLANNED,
        CHECKED,
        entry("uploading", 1.13, "uav-1"),
        entry("uploading", 1.13, "uav-2"),
        entry("verified", 1.33, "uav-2"),
        entry("verified", 1.43, "uav-1"),
        entry("flying", 1.5, plan_id="plan-2"),
        entry("closed", 1.51),
    ]
    (one,) = recoveries([REPORT], journal, None)
    steps = {step.name: step for step in one.steps}
    assert steps["Replan"].took == "100 ms"
    assert steps["Upload"].detail == "uav-1, uav-2"
    assert steps["Upload"].took == "200 ms"
    assert steps["Verified on board"].detail == "uav-2, uav-1"
    assert one.steps[-1].name == "Survivors fly the new plan"
    assert one.steps[-1].took == "510 ms in all"
    assert {step.state for step in one.steps} == {"done"}
    assert one.title == "uav-3: survivors fly the new plan"


def test_a_failed_recovery_says_why() -> None:
    report = {**REPORT, "outcome": "too_late", "error": "no slot is left", "in_force_at_s": None, "plan_id": None}
    (one,) = recoveries([report], [DETECTED, entry("refused", 1.1, attempt=1, error="too close")], None)
    assert one.steps[1].state == "failed"
    assert one.steps[-1].state == "failed"
    assert one.steps[-1].detail == "no slot is left"


def test_an_operation_that_ends_leaves_no_recovery_running() -> None:
    (one,) = recoveries([], [DETECTED, REPLANNED], None, over=True)
    assert one.phase == "unanswered"
    assert [step.state for step in one.steps] == ["done", "done", "failed"]


def test_two_incidents_are_two_recoveries() -> None:
    second = {**REPORT, "incident": 2, "lost": {"uav-1": 6.0}}
    made = recoveries([REPORT, second], [DETECTED, entry("detected", 9.0, incident=2, lost={"uav-1": 6.0})], None)
    assert [one.number for one in made] == [1, 2]
    assert [list(one.lost) for one in made] == [["uav-3"], ["uav-1"]]
