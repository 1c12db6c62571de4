"""Recoveries, from the journal and the final report."""

from typing import Any

from skyfolio.api.dashboard.changes import of_plan
from skyfolio.api.dashboard.recoveries import recoveries
from skyfolio.planner import Pins, Plan, replan

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


def test_a_finished_recovery_says_what_changed_and_which_pins_were_dropped() -> None:
    changed = {"users_changed": 2, "path_changed_m": 31.4, "weight_kbps": 5.0, "price_bps": 9_000.0}
    pins = {"uavs": ["uav-1"], "users": [], "dropped": [{"id": "uav-3", "reason": "'uav-3' is lost"}]}
    (one,) = recoveries([{**REPORT, "disruption": changed, "pins": pins}], [DETECTED], None)
    assert one.changes == (
        "2 users change server, UAVs fly 31 m off their old paths; priced 9.00 kbit/s",
        "Pins kept: uav-1",
        "Pin of uav-3 dropped: 'uav-3' is lost",
    )
    (old,) = recoveries([REPORT], [DETECTED], None)
    assert old.changes == (), "reports that were stored before say nothing"


def test_a_replan_says_the_same_of_itself(small_plan: Plan) -> None:
    pinned = small_plan.model_copy(update={"pins": Pins(associations={"user-1": small_plan.association["user-1"][1]})})
    made = replan(pinned, at_slot=1, keep_pins=True, n_starts=1)
    lines = of_plan(made)
    assert "server, UAVs fly" in lines[0]
    assert lines[1] == "Pins kept: user-1"
    assert of_plan(small_plan) == ()
