"""What base stations must serve, over HTTP: now and next, acknowledged, and changed at once after a loss."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from skyfolio import sim
from skyfolio.api.flights.operation_views import State
from skyfolio.planner import EXAMPLES, Plan, Utility
from tests.api.sky import Sky, flight

SLOT_S = 5.0
FLEET = EXAMPLES["paper"]().with_changes(
    altitude_m=10.0, slots=10, utility=Utility(kind="pooled", mu_per_kbps=-0.1)
)  # everybody is served


@pytest.fixture
def sky() -> Iterator[Sky]:
    with flight(FLEET, plan_ahead=False) as made:
        yield made


def allocations(sky: Sky, operation_id: str) -> dict[str, Any]:
    answer = sky.http.get(f"/v1/operations/{operation_id}/allocations")
    assert answer.status_code == 200, answer.text
    return dict(answer.json())


def acknowledge(sky: Sky, operation_id: str, uav_id: str, revision: int) -> Any:
    return sky.http.post(
        f"/v1/operations/{operation_id}/allocations:acknowledge", json={"uav_id": uav_id, "revision": revision}
    )


def users_of(view: dict[str, Any], when: str = "now") -> dict[str, set[str]]:
    return {uav: set(one[when]["bandwidth_hz"]) for uav, one in view["uavs"].items() if one[when]}


def slot_is(sky: Sky, operation_id: str, slot: int) -> None:
    sky.until(operation_id, lambda view: view.slot == slot)


def test_each_slot_is_published_as_it_begins_with_the_one_that_follows(sky: Sky) -> None:
    operation = sky.client.fly(sky.plan.id)
    before = allocations(sky, operation.id)
    assert all(one["now"] is None and one["next"]["slot"] == 0 for one in before["uavs"].values())
    slot_is(sky, operation.id, 2)
    view = allocations(sky, operation.id)
    told = sky.told(operation.id, "allocations")
    assert [one["uavs"]["uav-1"]["now"]["slot"] for one in told] == [0, 1, 2]
    assert [one["revision"] for one in told] == [1, 2, 3]
    assert view["revision"] == 3
    for uav, one in view["uavs"].items():
        for when, slot in (("now", 2), ("next", 3)):
            planned = {
                user: row[slot]
                for user, row in sky.plan.bandwidth_hz.items()
                if row[slot] > 0 and sky.plan.association[user][slot] == uav
            }
            assert one[when]["slot"] == slot
            assert one[when]["bandwidth_hz"] == pytest.approx(planned)
        assert sum(one["now"]["bandwidth_hz"].values()) == pytest.approx(10_000.0)
        assert one["now"]["valid_until_s"] == one["next"]["valid_from_s"] == 3 * SLOT_S
    ended = sky.ended(operation.id)
    assert ended.state == State.COMPLETED
    last = sky.told(operation.id, "allocations")[-1]
    assert all(one["now"] is None and one["next"] is None for one in last["uavs"].values())
    assert sky.http.get(f"/v1/operations/{operation.id}/allocations").status_code == 409


def test_an_acknowledgement_may_be_repeated_and_what_is_stale_or_unknown_is_refused(sky: Sky) -> None:
    operation_id = sky.take_off()
    slot_is(sky, operation_id, 1)
    revision = allocations(sky, operation_id)["revision"]
    first, again = (acknowledge(sky, operation_id, "uav-1", revision) for _ in range(2))
    assert first.status_code == again.status_code == 200
    assert first.json()["allocation"]["now"]["slot"] == 1
    assert allocations(sky, operation_id)["uavs"]["uav-1"]["acknowledged"] == revision
    assert allocations(sky, operation_id)["uavs"]["uav-2"]["acknowledged"] is None
    assert acknowledge(sky, operation_id, "uav-9", revision).status_code == 422
    ahead = acknowledge(sky, operation_id, "uav-1", revision + 1)
    assert (ahead.status_code, "was not given yet" in ahead.text) == (422, True)
    slot_is(sky, operation_id, 2)
    stale = acknowledge(sky, operation_id, "uav-1", revision)
    assert (stale.status_code, f"the newest is {revision + 1}" in stale.text) == (409, True)
    slot_is(sky, operation_id, 3)
    assert sky.told(operation_id, "allocations")[-1]["unacknowledged"] == ["uav-1"]  # uav-2 has no base station


def test_users_of_a_lost_uav_are_served_by_the_others_before_any_uav_has_moved(sky: Sky) -> None:
    operation_id = sky.take_off()
    slot_is(sky, operation_id, 2)
    sky.ground.workers.seconds = lambda job: 0.05 if job.task == "reassociate" else 2.0
    sky.inject(sim.Kill(3))
    sky.until(operation_id, lambda view: view.recoveries)
    [lost] = [event for event in sky.events() if event["kind"] == "uav_lost"]
    [told] = [event for event in sky.events() if event["kind"] == "reassociated"]
    [recovery] = sky.client.operation(operation_id).recoveries
    published = next(event for event in sky.events() if event["kind"] == "allocations" and event["id"] > lost["id"])[
        "data"
    ]
    assert published["revision"] == told["data"]["revision"]
    assert recovery.in_force_at_s is not None
    assert published["elapsed_s"] - recovery.declared_at_s < 0.3 * SLOT_S
    assert recovery.in_force_at_s - recovery.declared_at_s > 0.3 * SLOT_S
    served = users_of(published)
    assert served["uav-3"] == set()
    assert served["uav-1"] | served["uav-2"] == set(FLEET.user_ids)
    plan = sky.client.read_plan(told["data"]["plan_id"])
    assert isinstance(plan, Plan)
    assert plan.trajectories_m["uav-1"] == sky.plan.trajectories_m["uav-1"][plan.first_slot :]
    rates = sky.ended(operation_id).user_rates_bps
    assert all((rates[user][5] or 0.0) > 0.0 for user in ("user-7", "user-8", "user-9"))


def test_the_new_plan_takes_over_from_what_was_served_at_once(sky: Sky) -> None:
    operation_id = sky.take_off()
    slot_is(sky, operation_id, 2)
    sky.inject(sim.Kill(3))
    view = sky.until(operation_id, lambda view: view.recoveries)
    assert view.recoveries[0].outcome == "flying"
    assert view.plan_ids == [sky.plan.id, view.plan_id]  # what was served at once is no plan that is flown
    sky.let_pass(0.5)
    assert allocations(sky, operation_id)["plan_id"] == view.plan_id


def test_while_the_operator_decides_users_are_served(sky: Sky) -> None:
    operation_id = sky.take_off(replanning="approve")
    slot_is(sky, operation_id, 2)
    sky.inject(sim.Kill(3))
    view = sky.until(operation_id, lambda view: view.proposal)
    sky.let_pass(0.5)
    served = users_of(allocations(sky, operation_id))
    assert served["uav-1"] | served["uav-2"] == set(FLEET.user_ids)
    assert view.plan_ids == [sky.plan.id]


def test_without_recovery_nothing_is_changed_by_itself() -> None:
    for options, policy in (({"reassociate": False}, "approve"), ({}, "off")):
        with flight(FLEET, plan_ahead=False, **options) as sky:
            operation_id = sky.take_off(replanning=policy)
            slot_is(sky, operation_id, 2)
            sky.inject(sim.Kill(3))
            sky.until(operation_id, lambda view: view.lost)
            sky.let_pass(1.0)
            served = users_of(allocations(sky, operation_id))
            assert served["uav-3"] == set()
            assert not {"user-7", "user-8", "user-9"} & (served["uav-1"] | served["uav-2"])
            assert sky.told(operation_id, "reassociated") == []


def test_after_a_restart_no_revision_is_given_twice_and_what_was_served_is_known(sky: Sky) -> None:
    operation_id = sky.take_off(replanning="approve")
    slot_is(sky, operation_id, 2)
    sky.inject(sim.Kill(3))
    sky.until(operation_id, lambda view: view.proposal)
    sky.let_pass(1.0)
    before = allocations(sky, operation_id)
    sky.ground.kill()
    sky.start()
    after = allocations(sky, operation_id)
    assert after["revision"] >= 1000 > before["revision"]
    assert after["plan_id"] == before["plan_id"] != sky.plan.id
    assert acknowledge(sky, operation_id, "uav-1", before["revision"]).status_code == 409


def test_a_pause_is_published_and_what_is_valid_stays_so(sky: Sky) -> None:
    operation_id = sky.take_off()
    slot_is(sky, operation_id, 1)
    running = allocations(sky, operation_id)
    assert sky.http.post(f"/v1/operations/{operation_id}:pause").status_code == 200
    sky.let_pass(12.0)
    paused = allocations(sky, operation_id)
    assert (running["paused"], paused["paused"]) == (False, True)
    assert paused["revision"] == running["revision"] + 1
    assert users_of(paused) == users_of(running)
    assert paused["elapsed_s"] < paused["uavs"]["uav-1"]["now"]["valid_until_s"]


def test_an_operation_that_does_not_exist_has_no_allocations(sky: Sky) -> None:
    assert sky.http.get("/v1/operations/none/allocations").status_code == 404
    assert acknowledge(sky, "none", "uav-1", 1).status_code == 404
