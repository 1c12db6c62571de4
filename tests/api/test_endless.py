"""Operations without a fixed end: extended in flight for as long as was asked, whatever happens meanwhile."""

from __future__ import annotations

from typing import Any

import pytest

from skyfolio import sim
from skyfolio.api.flights.journal import Entry
from skyfolio.api.flights.operation_views import State
from skyfolio.api.flights.recovery_report import RecoveryReport
from skyfolio.planner import Plan
from tests.api.endless import EVERY, HORIZON, SCENARIO, SLOT_S, Apart, ended, extensions, take_off
from tests.api.field import Case
from tests.api.sky import Sky, flight
from tests.api.test_killed import MATRIX, kill_at

pytestmark = pytest.mark.timeout(1800)
MINUTES_S = 600.0
UAVS = SCENARIO.uav_ids
CALM: dict[str, Any] = {"plan_ahead": False}


def landed_at_home(sky: Sky, *system_ids: int) -> None:
    """These vehicles are on the ground where they took off, and have come down by themselves and whole."""
    for system_id in system_ids:
        assert sky.fleet.truth.happened("landed", system_id), system_id
        assert not sky.fleet.truth.happened("crashed", system_id), system_id
        body = sky.fleet.vehicles[system_id].autopilot.dynamics.body
        assert (body.east_m**2 + body.north_m**2) ** 0.5 < 5.0, system_id


def plan_of(sky: Sky, report: RecoveryReport) -> Plan:
    """The plan that a recovery made."""
    made = sky.client.read_plan(str(report.plan_id))
    assert isinstance(made, Plan)
    return made


@pytest.mark.parametrize("guidance", ["mission", "stream"])
def test_ten_minutes_are_flown_with_plans_of_a_hundred_seconds(guidance: str) -> None:
    with flight(SCENARIO, **CALM) as sky:
        sky.set_parameters({"COM_OBL_RC_ACT": 5})  # else no stream
        apart = Apart(sky)
        operation_id = take_off(sky, MINUTES_S, guidance=guidance)
        sky.let_pass(MINUTES_S / 2)
        modes = {vehicle.autopilot.mode for vehicle in sky.fleet.vehicles.values()}
        assert modes == {sim.Mode.GUIDED if guidance == "stream" else sim.Mode.MISSION}
        view = ended(sky, operation_id)
        assert (view.state, view.error) == (State.COMPLETED, None)
        assert view.endless is not None
        assert view.endless.planned_slots == view.endless.end_slot == MINUTES_S / SLOT_S
        assert view.endless.extensions >= (MINUTES_S / SLOT_S - HORIZON) / EVERY
        assert set(extensions(view)) == {"flying"}
        assert apart.closest_m >= SCENARIO.min_separation_m
        landed_at_home(sky, 1, 2, 3)
        rates = sky.http.get(f"/v1/operations/{operation_id}/rates").json()
        assert [row["slot"] for row in rates] == list(range(int(MINUTES_S / SLOT_S)))
        totals = [sum(rate or 0.0 for rate in row["rates_bps"].values()) for row in rates]
        assert min(totals) > 0.5 * totals[-1], "users were served in every slot"


def test_memory_documents_and_the_database_do_not_grow_with_the_hours() -> None:
    with flight(SCENARIO, **CALM) as sky:
        operation_id = take_off(sky, None)
        operation = sky.service.operations.active(operation_id)
        assert operation is not None

        def held() -> tuple[int, ...]:
            flown = operation.flight
            return (
                len(flown.record),
                max(map(len, flown.reported_rates_bps().values())),
                len(flown.timeline),
                len(operation.incidents.reports),
                len(operation._document()["timeline"]),
            )

        sky.let_pass(400.0)
        early = held()
        sky.let_pass(400.0)
        late = held()
        assert all(now <= before * 1.25 + 2 for before, now in zip(early, late, strict=True)), (early, late)
        with sky.ground.disk.engine.connect() as connection:
            given = connection.exec_driver_sql("SELECT count(*) FROM given").scalar_one()
            tracked = connection.exec_driver_sql("SELECT count(*) FROM track WHERE elapsed_s < 300").scalar_one()
        assert given <= 16 * len(UAVS)
        assert tracked <= 300 / 5 + 1
        assert sky.http.post(f"/v1/operations/{operation_id}:extend", json={"duration_s": 1.0}).status_code == 200
        assert ended(sky, operation_id).state == State.COMPLETED


@pytest.mark.parametrize("case", MATRIX, ids=str)
def test_wherever_the_service_is_killed_in_an_extension_the_next_one_goes_on_extending(case: Case) -> None:
    with flight(SCENARIO, **CALM) as sky:
        apart = Apart(sky)
        operation_id = take_off(sky, 300.0)
        kill_at(case, sky)
        sky.wait(lambda: sky.ground.service is None, f"never came to {case}")
        sky.let_pass(2.0)
        sky.start()
        view = ended(sky, operation_id)
        assert (view.state, view.error) == (State.COMPLETED, None)
        assert view.endless is not None
        assert view.endless.planned_slots == 300.0 / SLOT_S
        assert view.lost == []
        assert apart.closest_m >= SCENARIO.min_separation_m
        journal = sky.http.get(f"/v1/operations/{operation_id}/journal").json()
        for incident in {entry["incident"] for entry in journal}:
            steps = [entry["step"] for entry in journal if entry["incident"] == incident]
            assert (steps[0], steps[-1], steps.count("closed")) == ("detected", "closed", 1)
        for system_id in (1, 2, 3):
            taken = [event.detail["mission_id"] for event in sky.fleet.truth.happened("mission_accepted", system_id)]
            assert len(taken) == len(set(taken)), "no mission is sent twice"
        landed_at_home(sky, 1, 2, 3)


@pytest.mark.parametrize("step", ["replanned", "checked", "uploading", "verified", "flying"])
def test_a_loss_in_the_middle_of_an_extension_is_answered_by_plans_that_reach_as_far(step: str) -> None:
    with flight(SCENARIO, **CALM) as sky:
        operation_id = take_off(sky, 400.0)
        struck: list[float] = []

        def strike(entry: Entry, stored: bool) -> None:
            if entry.step == step and stored and not struck:
                struck.append(sky.now_s)
                sky.inject(sim.Kill(3))

        sky.service.journal.listeners.append(strike)
        view = sky.until(operation_id, lambda view: any(report.lost for report in view.recoveries))
        report = next(report for report in view.recoveries if report.lost)
        assert struck
        assert (report.outcome, list(report.lost)) == ("flying", ["uav-3"])
        assert view.endless is not None
        assert view.endless.planned_slots >= report.at_slot + HORIZON - EVERY
        view = ended(sky, operation_id)
        assert (view.state, view.error, view.lost) == (State.COMPLETED, None, ["uav-3"])
        assert view.endless is not None
        assert view.endless.planned_slots == 400.0 / SLOT_S
        landed_at_home(sky, 1, 2)


def test_a_loss_ends_an_extension_that_has_sent_nothing_and_its_plan_reaches_to_the_horizon() -> None:
    with flight(SCENARIO, **CALM) as sky:
        operation_id = take_off(sky, 400.0)
        sky.let_pass(EVERY * SLOT_S - 9.0)
        killed_s, solving = sky.now_s, sky.ground.workers.seconds
        sky.inject(sim.Kill(3))  # about 5 s before it is declared lost, and 4 s before the extension is due

        def seconds(job: Any) -> float:
            return 30.0 if job.previous is not None and sky.now_s < killed_s + 4.9 else solving(job)

        sky.ground.workers.seconds = seconds
        view = sky.until(operation_id, lambda view: any(report.lost for report in view.recoveries))
        report = next(report for report in view.recoveries if report.lost)
        assert extensions(view)[0] == "superseded"
        assert report.outcome == "flying"
        assert plan_of(sky, report).scenario.slots == HORIZON


def test_nothing_is_sent_while_a_uav_may_be_dying_unless_another_was_lost() -> None:
    with flight(SCENARIO, **CALM) as sky:
        operation_id = take_off(sky, 400.0)
        sky.let_pass(EVERY * SLOT_S - 8.2)
        killed_s = sky.now_s
        sky.inject(sim.Kill(3))  # its link is stale when the extension is solved
        view = sky.until(operation_id, lambda view: any(report.lost for report in view.recoveries))
        report = next(report for report in view.recoveries if report.lost)
        assert extensions(view)[0] == "superseded"
        assert report.outcome == "flying"
        assert sky.now_s - killed_s < 8.0


def test_a_plan_made_ahead_answers_a_loss_and_is_extended_afterwards() -> None:
    with flight(SCENARIO) as sky:
        operation_id = take_off(sky, 300.0)
        sky.let_pass(8.0)
        sky.inject(sim.Kill(3))
        view = ended(sky, operation_id)
        assert [report.source for report in view.recoveries if report.lost] == ["planned_ahead"]
        assert view.endless is not None
        assert view.endless.planned_slots == 300.0 / SLOT_S
        assert view.state == State.COMPLETED


def test_a_uav_that_returns_is_readmitted_long_after_the_first_plan_is_over() -> None:
    with flight(SCENARIO, **CALM) as sky:
        operation_id = take_off(sky, 400.0)
        sky.let_pass(150.0)
        sky.inject(sim.Mute(3, for_s=12.0))
        sky.until(operation_id, lambda view: view.returned == ["uav-3"])
        sky.until(operation_id, lambda view: any(report.lost for report in view.recoveries))
        assert sky.client.command(operation_id, "readmit", uav_id="uav-3").lost == []
        view = sky.until(operation_id, lambda view: any(one.cause == "uav_returned" for one in view.recoveries))
        report = next(report for report in view.recoveries if report.cause == "uav_returned")
        assert (report.outcome, report.error) == ("flying", None)
        assert set(plan_of(sky, report).trajectories_m) == set(UAVS)


@pytest.mark.parametrize("trouble", ["slow", "full"])
def test_while_the_database_is_slow_or_full_plans_are_extended_all_the_same(trouble: str) -> None:
    with flight(SCENARIO, **CALM) as sky:
        operation_id = take_off(sky, 300.0)
        sky.let_pass(10.0)
        if trouble == "slow":
            sky.ground.disk.commit_s = 2.0
        else:
            sky.ground.disk.refuses = "database or disk is full"
        sky.let_pass(120.0)
        operation = sky.service.operations.active(operation_id)
        assert operation is not None
        assert operation.flight.n_slots >= (130.0 / SLOT_S) + HORIZON - 2 * EVERY
        sky.ground.disk.refuses, sky.ground.disk.commit_s = None, 0.002
        view = ended(sky, operation_id)
        assert (view.state, view.error) == (State.COMPLETED, None)
        rates = sky.http.get(f"/v1/operations/{operation_id}/rates").json()
        assert [row["slot"] for row in rates] == list(range(int(300.0 / SLOT_S)))


def test_a_plan_that_cannot_be_extended_keeps_the_last_good_one_and_the_next_try_extends_it() -> None:
    with flight(SCENARIO, **CALM) as sky:
        operation_id = take_off(sky, 300.0)
        first = sky.client.operation(operation_id).plan_id
        sky.ground.workers.dead = True
        sky.until(operation_id, lambda view: len(extensions(view)) >= 2)
        view = sky.client.operation(operation_id)
        assert (view.plan_id, set(extensions(view))) == (first, {"failed"})
        sky.ground.workers.dead = False
        view = ended(sky, operation_id)
        assert view.state == State.COMPLETED
        assert view.endless is not None
        assert view.endless.planned_slots == 300.0 / SLOT_S


@pytest.mark.parametrize("guidance", ["mission", "stream"])
def test_the_vehicles_of_a_service_that_is_killed_for_good_return_in_order_at_the_end_of_the_horizon(
    guidance: str,
) -> None:
    with flight(SCENARIO, **CALM) as sky:
        sky.set_parameters({"COM_OBL_RC_ACT": 5})  # else no stream
        apart = Apart(sky)
        operation_id = take_off(sky, 3600.0, guidance=guidance)
        sky.until(operation_id, lambda view: view.endless is not None and view.endless.extensions >= 3)
        view = sky.client.operation(operation_id)
        assert view.endless is not None
        planned_s = view.endless.planned_slots * SLOT_S
        left_s = planned_s - (view.elapsed_s or 0.0)
        sky.ground.kill()
        sky.let_pass(left_s - 2 * SLOT_S)
        assert not any(sky.fleet.truth.happened("landed", number) for number in (1, 2, 3)), "they fly their plan first"
        sky.let_pass(2 * SLOT_S + 120.0)
        landed_at_home(sky, 1, 2, 3)
        assert apart.closest_m >= SCENARIO.min_separation_m
        sky.start()
        assert ended(sky, operation_id).state == State.COMPLETED


def test_the_end_is_moved_in_flight_and_an_operation_with_a_fixed_end_has_none_to_move() -> None:
    with flight(SCENARIO, **CALM) as sky:
        operation_id = take_off(sky, 150.0)
        path = f"/v1/operations/{operation_id}:extend"
        assert sky.http.post(path, json={}).status_code == 422
        assert sky.http.post(path, json={"duration_s": 200.0, "until": "2030-01-01T00:00:00Z"}).status_code == 422
        assert sky.http.post(path, json={"until": "2030-01-01T00:00:00"}).status_code == 422, "an offset is needed"
        moved = sky.client.command(operation_id, "extend", duration_s=200.0)
        assert moved.endless is not None
        assert moved.endless.end_slot == 40
        view = ended(sky, operation_id)
        assert view.endless is not None
        assert (view.state, view.endless.planned_slots) == (State.COMPLETED, 40)
        assert sky.http.post(path, json={"duration_s": 300.0}).status_code == 409
        second = sky.take_off()
        answer = sky.http.post(f"/v1/operations/{second}:extend", json={"duration_s": 300.0})
        assert (answer.status_code, "one plan to its end" in answer.text) == (409, True)


@pytest.mark.parametrize(
    ("asked", "named"),
    [
        ({"replan_every_slots": 18}, "replan_every_slots"),
        ({"duration_s": 50.0}, "duration_s"),
        ({"duration_s": 500.0, "until": "2030-01-01T00:00:00Z"}, "until"),
        ({"horizon_slots": 3}, "horizon_slots"),
        ({"scenario": SCENARIO.model_dump(mode="json")}, "plan_id, scenario"),
    ],
)
def test_what_cannot_be_extended_is_refused_with_field_and_rule(asked: dict[str, Any], named: str) -> None:
    with flight(SCENARIO, **CALM) as sky:
        answer = sky.http.post("/v1/operations", json={"plan_id": sky.plan.id, **asked})
        assert answer.status_code == 422
        assert named in answer.text


def test_a_scenario_is_planned_and_flown_by_one_request() -> None:
    with flight(SCENARIO, **CALM) as sky:
        body = {"scenario": SCENARIO.model_dump(mode="json"), "horizon_slots": 12, "duration_s": 120.0}
        made = sky.http.post("/v1/operations", json=body, headers={"Idempotency-Key": "once"})
        assert made.status_code == 202, made.text
        again = sky.http.post("/v1/operations", json=body, headers={"Idempotency-Key": "once"})
        assert again.json()["id"] == made.json()["id"]
        view = ended(sky, made.json()["id"])
        assert view.endless is not None
        assert (view.state, view.endless.horizon_slots, view.endless.planned_slots) == (State.COMPLETED, 12, 24)
