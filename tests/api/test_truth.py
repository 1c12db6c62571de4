"""The judge of a drill: it must not pass a flight that was not flown."""

from dataclasses import replace
from math import hypot
from typing import Any

import pytest

from skyfolio import sim
from skyfolio.api.lab.demo.orders import DemoConfig, Outcome
from skyfolio.api.lab.demo.truth import judge
from skyfolio.mavlink_bridge import east_north_to_geodetic
from skyfolio.planner import EXAMPLES, Plan, plan, replan

CONFIG = DemoConfig(kill="uav-2", kill_slot=3)
SLOT0_S = 40.0
KILL_S = 10.0
IN_FORCE_S = 16.0


@pytest.fixture(scope="module")
def plans() -> list[Plan]:
    """Three slots in, uav-2 is lost; the new plan begins with slot 4 of 12."""
    scenario = EXAMPLES["minimal"]().with_changes(slots=12)
    first = plan(scenario)
    moved = {**first.trajectories_m, "uav-1": [(50.0 + 8 * n, 50.0) for n in range(12)]}
    first = first.model_copy(update={"trajectories_m": moved})
    second = replan(first, failed=["uav-2"], at_slot=4)
    back = {"uav-1": [(82.0 - 9 * n, 50.0 + 3 * n) for n in range(8)]}
    return [first, second.model_copy(update={"trajectories_m": back})]


def along(path: list[tuple[float, float]], slots: float) -> tuple[float, float]:
    n = min(int(slots), len(path) - 2)
    share = min(slots - n, 1.0)
    (e0, n0), (e1, n1) = path[n], path[n + 1]
    return e0 + share * (e1 - e0), n0 + share * (n1 - n0)


def flown(plans: list[Plan], *, obey: bool = True, falls_late_s: float = 0.0) -> sim.TruthLog:
    """Ground truth of a perfect flight; with obey=False the survivor stays on the first plan."""
    log = sim.TruthLog()
    first, second = plans
    log.events.append(sim.Event(SLOT0_S + KILL_S, 2, "killed", {}))
    log.events.append(sim.Event(SLOT0_S + IN_FORCE_S, 1, "mission_accepted", {"items": []}))
    for step in range(700):
        at = step / 10
        for system, uav in ((1, "uav-1"), (2, "uav-2")):
            follows_new = obey and system == 1 and at >= IN_FORCE_S
            path, begun = (second, 4.0) if follows_new else (first, 0.0)
            where = along(path.trajectories_m[uav], max(at / 5 - begun, 0.0))
            lat, lon = east_north_to_geodetic(first.scenario.origin, *where)
            alive = system == 1 or at < KILL_S + falls_late_s
            log.samples.append(
                sim.Sample(SLOT0_S + at, system, lat, lon, 30.0, 2.0, "MISSION", True, alive, alive, 7, 1)
            )
    log.events.append(sim.Event(SLOT0_S + 69.0, 1, "landed", {}))
    return log


def outcome(plans: list[Plan], **changes: Any) -> Outcome:
    recovery = {
        "outcome": "flying",
        "declared_at_s": 15.5,
        "replan_ms": 12.0,
        "upload_s": 0.1,
        "in_force_at_s": IN_FORCE_S,
        "error": None,
    }
    ends = {uav: {"end": "lost" if uav == CONFIG.kill else "flown"} for uav in plans[0].scenario.uav_ids}
    operation = {"state": "completed", "error": None, "recoveries": [recovery], "uavs": ends, **changes}
    return Outcome(operation, plans, SLOT0_S, SLOT0_S + KILL_S)


def is_served(made: Plan, user: str) -> bool:
    """Whether the plan gives the user a rate worth the name in the slot of the loss."""
    return made.user_rates_bps[user][2] > 1000.0


def failed_checks(plans: list[Plan], log: sim.TruthLog, said: Outcome) -> list[str]:
    report = judge(CONFIG, plans[0].scenario, log, said, wall_s=1.0)
    assert report.passed == all(check.passed for check in report.checks)
    return [check.name for check in report.checks if not check.passed]


def test_a_flight_that_was_flown_passes_with_the_right_timings(plans: list[Plan]) -> None:
    report = judge(CONFIG, plans[0].scenario, flown(plans), outcome(plans), wall_s=1.0)
    assert [check.name for check in report.checks if not check.passed] == []
    assert report.passed
    assert report.detection_s == pytest.approx(5.5)
    assert report.slots_without_service == pytest.approx((IN_FORCE_S - KILL_S) / 5)
    served = next(user for user, row in plans[0].association.items() if row[2] == "uav-2" and is_served(plans[0], user))
    assert report.flown.user_rates_bps[served][1] > 1000.0
    assert report.flown.user_rates_bps[served][2] == pytest.approx(0.0)
    assert report.tracking["uav-1"].worst_m < 10.0


def test_what_base_stations_measured_counts_and_what_they_did_not_is_computed(plans: list[Plan]) -> None:
    computed = judge(CONFIG, plans[0].scenario, flown(plans), outcome(plans), wall_s=1.0)
    assert computed.measured_slots == []
    users = plans[0].scenario.user_ids
    orphans = {user for user, row in plans[0].association.items() if row[2] == "uav-2" and is_served(plans[0], user)}
    dark = dict.fromkeys(set(users) - orphans, 400.0)
    everybody = dict.fromkeys(users, 400.0)
    served = [(at, everybody) for at in range(10)]
    received = [*served, (10.5, dark), (12.0, dark), *((float(at), everybody) for at in range(13, 55))]
    report = judge(CONFIG, plans[0].scenario, flown(plans), replace(outcome(plans), received=received), wall_s=1.0)
    assert report.measured_slots == list(range(11))
    assert report.slots_without_service == pytest.approx((13.0 - KILL_S) / 5), "before the new plan was in force"
    orphan = orphans.pop()
    assert report.flown.user_rates_bps[orphan][:4] == pytest.approx([400.0, 400.0, 400.0 * 2 / 4, 400.0])
    assert report.flown.user_rates_bps[orphan][11] == computed.flown.user_rates_bps[orphan][11]
    assert report.flown.mean_sum_rate_before_bps == pytest.approx(400.0 * len(users))


@pytest.mark.parametrize("clock_error_s", [-1e-6, 0.0, 1e-6, 0.05])
def test_a_user_is_unserved_after_the_loss_though_the_uav_served_an_instant_longer(
    plans: list[Plan], clock_error_s: float
) -> None:
    said = outcome(plans[:1], recoveries=[])
    said = replace(said, slot0_s=SLOT0_S + clock_error_s)
    without = replace(CONFIG, replan=False)
    log = flown(plans, obey=False, falls_late_s=0.15)
    report = judge(without, plans[0].scenario, log, said, wall_s=1.0)
    orphans = {user for user, row in plans[0].association.items() if set(row[2:]) == {"uav-2"}}
    assert orphans
    assert set(report.flown.unserved_after) >= orphans


def test_a_survivor_that_stays_on_the_old_plan_fails(plans: list[Plan]) -> None:
    assert failed_checks(plans, flown(plans, obey=False), outcome(plans)) == ["uav-1 flew its plan", "uav-1 landed"]


def test_a_mission_that_never_arrived_fails(plans: list[Plan]) -> None:
    log = flown(plans)
    log.events = [event for event in log.events if event.kind != "mission_accepted"]
    assert failed_checks(plans, log, outcome(plans)) == ["uav-1 got a new mission in flight"]


def test_a_uav_that_did_not_fall_fails(plans: list[Plan]) -> None:
    log = flown(plans)
    log.events = [event for event in log.events if event.kind != "killed"]
    assert failed_checks(plans, log, outcome(plans)) == ["uav-2 fell as ordered"]


def test_a_survivor_that_never_landed_fails(plans: list[Plan]) -> None:
    log = flown(plans)
    log.events = [event for event in log.events if event.kind != "landed"]
    assert failed_checks(plans, log, outcome(plans)) == ["uav-1 landed"]


def test_a_service_that_says_it_failed_fails(plans: list[Plan]) -> None:
    assert failed_checks(plans, flown(plans), outcome(plans, state="failed")) == ["operation completed"]
    said = outcome(plans)
    said.operation["recoveries"][0].update(outcome="partly_flying", error="uav-1 did not confirm")
    assert failed_checks(plans, flown(plans), said) == ["service says the survivors fly a new plan"]


def test_two_uavs_that_truly_came_too_close_fail(plans: list[Plan]) -> None:
    log = flown(plans)
    near = next(sample for sample in log.samples if sample.system_id == 1 and sample.t_s == SLOT0_S + 5.0)
    rows = [near._replace(system_id=2) if (row.t_s, row.system_id) == (near.t_s, 2) else row for row in log.samples]
    log.samples.clear()
    log.samples.extend(rows)
    assert failed_checks(plans, log, outcome(plans)) == ["separation kept"]


def test_the_synthetic_survivor_really_moves(plans: list[Plan]) -> None:
    first, second = (made.trajectories_m["uav-1"][-1] for made in plans)
    assert hypot(first[0] - second[0], first[1] - second[1]) > 20.0
