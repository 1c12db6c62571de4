"""Judgement of a drill by the ground truth: what users truly received, and whether missions were flown."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from math import ceil, hypot, inf
from typing import Any

import numpy as np

from skyfolio import sim
from skyfolio.api.flights.rates import InForce, Sample, rates_by_sample, rates_by_slot
from skyfolio.api.lab.demo.orders import DemoConfig, Outcome
from skyfolio.api.lab.demo.received import Received, measured_over, sums, without_service_s
from skyfolio.api.lab.demo.report import UNSERVED_BPS, Check, DemoReport, Rates, Tracking
from skyfolio.mavlink_bridge import geodetic_to_east_north
from skyfolio.planner import Plan, Scenario, plan
from skyfolio.planner.arrays import Array
from skyfolio.planner.geometry import Point
from skyfolio.planner.utility import jain_index, utility_kbps

PASSED_WITHIN_M = 3.0
"""A waypoint counts as flown when the true track passes this near: acceptance radius and cornering at 5 m/s."""

ORDERED_WITHIN_S = 0.5
"""A fault strikes this soon after its moment: the simulator's step, and how well slot 0 is known. Slots that begin
later are surely after it."""


class Course:
    """The ground truth on the operation's clock: seconds since slot 0, metres east/north."""

    def __init__(self, scenario: Scenario, truth: sim.TruthLog, slot0_s: float) -> None:
        self.scenario = scenario
        self.uavs = dict(enumerate(scenario.uav_ids, start=1))
        self._rows: dict[str, list[tuple[float, Point, sim.Sample]]] = {uav: [] for uav in scenario.uav_ids}
        for row in truth.samples:
            where = geodetic_to_east_north(scenario.origin, row.lat_deg, row.lon_deg)
            self._rows[self.uavs[row.system_id]].append((row.t_s - slot0_s, where, row))
        self.events = [(event.t_s - slot0_s, self.uavs[event.system_id], event) for event in truth.events]

    def track(self, uav: str, from_s: float = -inf, to_s: float = inf) -> list[tuple[float, float, float]]:
        """Return (seconds, east, north) of the true track while the UAV was not wrecked."""
        return [
            (at, where[0], where[1])
            for at, where, row in self._rows[uav]
            if from_s <= at <= to_s and (row.alive or from_s == -inf)
        ]

    def samples(self) -> list[Sample]:
        """Everyone's true position at each instant of the slots; a dead or landed UAV serves no user."""
        end_s = self.scenario.slots * self.scenario.slot_duration_s
        instants: dict[float, dict[str, tuple[Point, bool]]] = {}
        for uav, rows in self._rows.items():
            for at, where, row in rows:
                if 0 <= at < end_s:
                    instants.setdefault(round(at, 3), {})[uav] = (where, row.alive and row.transmitting)
        return [
            Sample(
                at,
                {uav: where for uav, (where, _) in here.items()},
                frozenset(uav for uav, (_, on) in here.items() if on),
            )
            for at, here in sorted(instants.items())
        ]

    def least_separation_m(self) -> float:
        """Closest approach of any two flying UAVs in the slots, at the sampled instants."""
        least = inf
        for sample in self.samples():
            for a, b in combinations(sorted(sample.transmitting), 2):
                (ea, na), (eb, nb) = sample.positions_m[a], sample.positions_m[b]
                least = min(least, hypot(ea - eb, na - nb))
        return least


def judge(config: DemoConfig, scenario: Scenario, log: sim.TruthLog, outcome: Outcome, *, wall_s: float) -> DemoReport:
    """Return the report: rates, timings, and every check, by the ground truth wherever there is one."""
    course = Course(scenario, log, outcome.slot0_s)
    kill_s = outcome.kill_at_s - outcome.slot0_s
    recovery: dict[str, Any] = next(iter(outcome.operation["recoveries"]), {})
    in_force_s = recovery.get("in_force_at_s")
    timeline = [InForce(0.0, outcome.plans[0])]
    timeline += [
        InForce(each["in_force_at_s"], plan) for plan, each in zip(outcome.plans[1:], _in_force(outcome), strict=True)
    ]
    checks = _checks(config, course, outcome, kill_s)
    slot_s, end_s = scenario.slot_duration_s, scenario.slots * scenario.slot_duration_s
    flown, measured = _flown(timeline, course, outcome.received, kill_s, in_force_s)
    outage_s = without_service_s(outcome.plans[0], config.kill, kill_s, outcome.received)
    return DemoReport(
        passed=all(check.passed for check in checks),
        checks=checks,
        replanned=config.replan,
        speedup=config.speedup,
        utility=scenario.utility,
        killed=config.kill,
        killed_at_slot=config.kill_slot,
        killed_at_s=kill_s,
        detection_s=recovery["declared_at_s"] - kill_s if recovery else None,
        replan_ms=recovery.get("replan_ms"),
        upload_s=recovery.get("upload_s"),
        new_plan_in_force_at_s=in_force_s,
        slots_without_service=((in_force_s or end_s) - kill_s if outage_s is None else outage_s) / slot_s,
        measured_slots=measured,
        flown=flown,
        no_replan=_computed(outcome.plans[0], config, kill_s, in_force_s),
        foreseen=_computed(_foreseeing(scenario, config), config, kill_s, in_force_s),
        tracking=_tracking(course, timeline, config.kill, kill_s),
        plans=outcome.plans,
        tracks_m={uav: course.track(uav, 0.0, end_s) for uav in scenario.uav_ids},
        wall_s=wall_s,
    )


def _in_force(outcome: Outcome) -> list[dict[str, float]]:
    return [each for each in outcome.operation["recoveries"] if each["in_force_at_s"] is not None]


def _flown(
    timeline: list[InForce], course: Course, received: Received, kill_s: float, in_force_s: float | None
) -> tuple[Rates, list[int]]:
    """Return what users truly got, and the slots in which that was measured."""
    samples = course.samples()
    computed = rates_by_slot(timeline, samples, course.scenario.slots)
    by_slot, measured = measured_over(computed, received, course.scenario)
    if received:
        at, in_sum = sums(received)
    else:
        at = np.array([sample.elapsed_s for sample in samples])
        in_sum = rates_by_sample(timeline, samples).sum(axis=1)
    return _rates(course.scenario, by_slot, at, in_sum, kill_s, in_force_s), measured


def _foreseeing(scenario: Scenario, config: DemoConfig) -> Plan:
    """Return the plan that a planner makes that knows of the loss from the start."""
    leaving = tuple(
        uav.model_copy(update={"leaves_at_slot": config.kill_slot - 1}) if uav.id == config.kill else uav
        for uav in scenario.uavs
    )
    return plan(scenario.with_changes(uavs=leaving))


def _computed(made: Plan, config: DemoConfig, kill_s: float, in_force_s: float | None) -> Rates:
    """Return the rates of a plan flown to its end as planned, with the lost UAV silent from its slot on."""
    scenario = made.scenario
    samples = [
        Sample(
            (n + 0.5) * scenario.slot_duration_s,
            {uav: made.trajectories_m[uav][n] for uav in scenario.uav_ids},
            frozenset(uav for uav in scenario.uav_ids if uav != config.kill or n < config.kill_slot - 1),
        )
        for n in range(scenario.slots)
    ]
    by_slot = rates_by_slot([InForce(0.0, made)], samples, scenario.slots)
    at = np.array([sample.elapsed_s for sample in samples])
    return _rates(scenario, by_slot, at, by_slot.sum(axis=0), kill_s, in_force_s)


def _rates(
    scenario: Scenario, by_slot: Array, at: Array, sums: Array, kill_s: float, in_force_s: float | None
) -> Rates:
    """Return the rates of a flight. at: (M,), seconds since slot 0, and sums: (M,) bit/s then; those in slots count."""
    planned = (at >= 0.0) & (at < scenario.slots * scenario.slot_duration_s)
    at, sums = at[planned], sums[planned]
    after_s = kill_s if in_force_s is None else in_force_s
    during = (at >= kill_s) & (at < after_s)
    per_slot = by_slot.sum(axis=0)
    each_after = by_slot[:, ceil((after_s + ORDERED_WITHIN_S) / scenario.slot_duration_s) :].mean(axis=1)
    return Rates(
        mean_sum_rate_before_bps=float(sums[at < kill_s].mean()),
        mean_sum_rate_during_bps=float(sums[during].mean()) if during.any() else None,
        mean_sum_rate_after_bps=float(sums[at >= after_s].mean()),
        worst_user_after_bps=float(each_after.min()),
        unserved_after=[user for user, rate in zip(scenario.user_ids, each_after, strict=True) if rate < UNSERVED_BPS],
        utility_bps=utility_kbps(by_slot / 1e3, scenario.utility.kind, scenario.utility.mu_per_kbps) * 1e3,
        sum_rate_variance_kbps2=float((per_slot / 1e3).var()),
        jain=jain_index(by_slot / 1e3),
        sum_rate_bps=per_slot.tolist(),
        user_rates_bps={user: row.tolist() for user, row in zip(scenario.user_ids, by_slot, strict=True)},
    )


def _tracking(course: Course, timeline: Sequence[InForce], killed: str, kill_s: float) -> dict[str, Tracking]:
    """Distance from schedule at each slot end, under the plan in force there."""
    found = {}
    slot_s = course.scenario.slot_duration_s
    for uav in course.scenario.uav_ids:
        track = np.array(course.track(uav, 0.0))
        errors = []
        for n in range(1, course.scenario.slots):
            now = n * slot_s
            if uav == killed and now > kill_s:
                break
            plan = next(entry.plan for entry in reversed(timeline) if entry.from_s <= now)
            e, s = plan.trajectories_m[uav][max(n - plan.first_slot, 0)]
            row = track[np.argmin(np.abs(track[:, 0] - now))]
            errors.append(hypot(row[1] - e, row[2] - s))
        found[uav] = Tracking(mean_m=float(np.mean(errors)), worst_m=float(np.max(errors)))
    return found


def _checks(config: DemoConfig, course: Course, outcome: Outcome, kill_s: float) -> list[Check]:
    survivors = [uav for uav in course.scenario.uav_ids if uav != config.kill]
    operation = outcome.operation
    expected = "completed" if config.replan else "completed_partly"  # unanswered, the plan counts on the lost one
    ended = {uav: seen["end"] for uav, seen in operation["uavs"].items()}
    checks = [
        _check(
            f"operation {expected.replace('_', ' ')}",
            operation["state"] == expected,
            operation["error"] or operation["state"],
        ),
        _check(
            "service says how each UAV ended",
            ended == {uav: "lost" if uav == config.kill else "flown" for uav in course.scenario.uav_ids},
            ", ".join(f"{uav} {end}" for uav, end in ended.items()),
        ),
        _fell(course, config.kill, kill_s),
    ]
    if config.replan:
        recovered = [each for each in operation["recoveries"] if each["outcome"] == "flying"]
        found = "; ".join(f"{each['outcome']}: {each['error'] or 'ok'}" for each in operation["recoveries"])
        checks.append(_check("service says the survivors fly a new plan", bool(recovered), found or "no recovery"))
    plan = outcome.plans[-1]
    since_s = _in_force(outcome)[-1]["in_force_at_s"] if _in_force(outcome) else 0.0
    if config.replan and len(outcome.plans) > 1:
        checks += [_accepted_after(course, uav, kill_s) for uav in survivors]
    checks += [_flew(course, uav, plan, since_s) for uav in survivors]
    checks += [_landed(course, uav, plan) for uav in survivors]
    least, limit = course.least_separation_m(), course.scenario.min_separation_m
    checks.append(_check("separation kept", least >= limit, f"closest approach {least:.1f} m, limit {limit:g} m"))
    return checks


def _check(name: str, passed: bool, detail: str) -> Check:
    return Check(name=name, passed=bool(passed), detail=detail)


def _fell(course: Course, uav: str, kill_s: float) -> Check:
    at = next((at for at, event_uav, event in course.events if event_uav == uav and event.kind == "killed"), None)
    passed = at is not None and abs(at - kill_s) < ORDERED_WITHIN_S
    return _check(f"{uav} fell as ordered", passed, "never" if at is None else f"{at:.2f} s after slot 1 began")


def _accepted_after(course: Course, uav: str, kill_s: float) -> Check:
    times = [
        at
        for at, event_uav, event in course.events
        if event_uav == uav and event.kind == "mission_accepted" and at > kill_s
    ]
    found = f"accepted at {times[-1]:.2f} s" if times else "no mission was accepted after the loss"
    return _check(f"{uav} got a new mission in flight", bool(times), found)


def _flew(course: Course, uav: str, plan: Plan, since_s: float) -> Check:
    """Check that the true track passed each point of the plan, one after the other."""
    track = course.track(uav, since_s)
    points = plan.trajectories_m[uav][1 if plan.first_slot else 0 :]
    begin, worst = 0, 0.0
    for number, (e, n) in enumerate(points):
        ahead = [hypot(row[1] - e, row[2] - n) for row in track[begin:]]
        near = next((i for i, apart in enumerate(ahead) if apart <= PASSED_WITHIN_M), None)
        if near is None:
            least = min(ahead, default=inf)
            return _check(f"{uav} flew its plan", False, f"point {number + 1}/{len(points)} missed by {least:.1f} m")
        worst = max(worst, ahead[near])
        begin += near
    detail = f"passed all {len(points)} points of {plan.id} in order, within {PASSED_WITHIN_M:g} m"
    return _check(f"{uav} flew its plan", True, detail)


def _landed(course: Course, uav: str, plan: Plan) -> Check:
    if not any(event_uav == uav and event.kind == "landed" for _, event_uav, event in course.events):
        return _check(f"{uav} landed", False, "never")
    _, e, n = course.track(uav)[-1]
    apart = hypot(e - plan.trajectories_m[uav][-1][0], n - plan.trajectories_m[uav][-1][1])
    return _check(f"{uav} landed", apart <= PASSED_WITHIN_M, f"{apart:.1f} m from the plan's last point")
