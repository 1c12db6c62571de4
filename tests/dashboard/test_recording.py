"""Stored operations: what replay shows at a moment, what the report says, and what a loss costs."""

import re

import pytest

from skyfolio.api.dashboard import comparison, report_page
from skyfolio.api.dashboard.recording import Recording, placed
from skyfolio.api.dashboard.report import lost_at, report_of
from skyfolio.api.dashboard.views import Drill, Operation, Recovery, ServiceEvent, TrackPoint
from skyfolio.planner import Plan, Scenario, plan, replan

SLOT_S = 5.0
FALLS_S = 11.0


@pytest.fixture(scope="module")
def plans(minimal: Scenario) -> tuple[Plan, Plan]:
    first = plan(minimal.with_changes(slots=8), id="plan-1")
    return first, replan(first, failed=["uav-2"], at_slot=4, id="plan-2")


@pytest.fixture
def operation(plans: tuple[Plan, Plan]) -> Operation:
    first, second = plans
    flown = {user: [*first.user_rates_bps[user][:4], *second.user_rates_bps[user]] for user in first.scenario.user_ids}
    recovery = Recovery(
        number=1,
        title="uav-2",
        lost={"uav-2": 5.0},
        phase="flying",
        declared_at_s=FALLS_S + 5.0,
        in_force_at_s=20.0,
        plan_id="plan-2",
    )
    return Operation(
        id="op-1",
        state="completed",
        policy="auto",
        plan_id="plan-2",
        plan_ids=("plan-1", "plan-2"),
        vehicles={"uav-1": 1, "uav-2": 2},
        lost=("uav-2",),
        user_rates_bps=flown,
        recoveries=(recovery,),
    )


@pytest.fixture
def track() -> list[TrackPoint]:
    """Uav-1 flies east at 2 m/s all the time; uav-2 north, until it falls."""
    points = []
    for tick in range(80):
        at = tick * 0.5
        where = {"uav-1": (50.0 + 2 * at, 50.0)}
        if at <= FALLS_S:
            where["uav-2"] = (150.0, 50.0 + at)
        points.append(TrackPoint(elapsed_s=at, positions_m=where))
    return points


@pytest.fixture
def recording(operation: Operation, plans: tuple[Plan, Plan], track: list[TrackPoint]) -> Recording:
    happened = ServiceEvent(id=1, at="2030-01-01T00:00:00+00:00", kind="operation", data={})
    return Recording(operation, {one.id: one for one in plans}, track, [(-3.0, happened)])


def test_replay_shows_who_was_where_and_which_way_they_went(recording: Recording) -> None:
    where = recording.where(10.0)
    assert (where["uav-1"][0], where["uav-2"][0]) == ((70.0, 50.0), (150.0, 60.0))
    assert [where[uav][1] for uav in ("uav-1", "uav-2")] == pytest.approx([90.0, 0.0])
    assert recording.where(30.0)["uav-2"][0] == (150.0, 50.0 + FALLS_S), "where it was last heard"
    assert recording.where(-1.0)["uav-1"][0] == (50.0, 50.0), "on its start before the first record"


def test_replay_knows_losses_and_plans_only_when_they_had_happened(recording: Recording) -> None:
    assert recording.lost(15.9) == ()
    assert recording.lost(16.0) == ("uav-2",)
    assert recording.in_force(19.9).id == "plan-1"
    assert recording.in_force(20.0).id == "plan-2"
    assert recording.slot(19.9) == 3
    assert recording.slot(-1.0) is None
    assert recording.slot(8 * SLOT_S) is None
    assert recording.begins_s == -3.0
    assert recording.ends_s == 8 * SLOT_S
    frame = recording.frame(17.0)
    assert [uav["lost"] for uav in frame["uavs"]] == [False, True]
    assert recording.rows(17.0)[1]["state"] == "LOST"
    assert len(recording.tracks(5.0)["uav-1"]) == 11


def test_events_are_placed_on_the_operations_own_clock() -> None:
    def at(second: int, kind: str, operation: str = "op-1", **data: str) -> ServiceEvent:
        told = {"operation_id": operation, **data}
        return ServiceEvent(id=second, at=f"2030-01-01T00:00:{second:02d}+00:00", kind=kind, data=told)

    log = [at(1, "missions_uploaded"), at(4, "operation", state="flying"), at(5, "uav_lost"), at(6, "link", "op-2")]
    assert [(when, one.kind) for when, one in placed(log, "op-1", 10.0)] == [
        (-30.0, "missions_uploaded"),
        (0.0, "operation"),
        (10.0, "uav_lost"),
    ]


def test_a_silent_uav_gives_its_users_nothing_and_all_others_no_less(plans: tuple[Plan, Plan]) -> None:
    first, _ = plans
    rates = comparison.without(first, ["uav-2"], 4)
    for user, row in rates.items():
        for n, rate in enumerate(row, start=4):
            if first.association[user][n] == "uav-2":
                assert rate == 0.0
            else:
                assert rate >= first.user_rates_bps[user][n] * (1 - 1e-9), "less interference"
    silent, planned = comparison.course(rates), comparison.course(comparison.rest(first, 4))
    assert silent.unserved > planned.unserved
    assert comparison.rows([silent])[0] == ("mean sum rate, kbit/s", f"{silent.mean_sum_rate_bps / 1e3:.2f}")
    assert comparison.course({"user-1": [0.0, 0.0]}).jain == 0.0


def test_the_report_compares_what_was_flown_with_doing_nothing(
    operation: Operation, plans: tuple[Plan, Plan], track: list[TrackPoint]
) -> None:
    drill = Drill(id="drill-1", state="struck", operation_id="op-1", uav_id="uav-2", fault="kill", at_slot=2)
    made = report_of(operation, plans, track, drill)
    assert lost_at(operation, SLOT_S) == {"uav-2": FALLS_S / SLOT_S}
    assert made.recovered
    assert made.without_recovery[:2] == pytest.approx(
        [sum(row[n] for row in plans[0].user_rates_bps.values()) for n in (0, 1)]
    )
    assert made.without_recovery[5] == pytest.approx(
        sum(row[1] for row in comparison.without(plans[0], ["uav-2"], 4).values())
    )
    page = report_page.page(made)
    assert page.count("<svg") == 2
    assert "Drill: kill of uav-2 when slot 2 begins" in page
    assert not re.search(r"<script|<link|src=|url\(|href=", page), "the page needs nothing but itself"


def test_an_operation_that_did_not_end_well_is_no_recovery(operation: Operation, plans: tuple[Plan, Plan]) -> None:
    failed = operation.model_copy(update={"state": "failed", "error": "lost: <everything>", "recoveries": ()})
    made = report_of(failed, plans[:1], [], None)
    assert not made.recovered
    assert "&lt;everything&gt;" in report_page.page(made)
    nothing = report_of(operation.model_copy(update={"recoveries": ()}), plans[:1], [], None)
    assert "no UAV was declared lost" in nothing.verdict
