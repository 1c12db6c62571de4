"""Delivered rates over a timeline of plans."""

import numpy as np
import pytest

from skyfolio.api.flights.rates import InForce, Sample, rates_by_sample, rates_by_slot
from skyfolio.planner import EXAMPLES, Plan, plan, replan


@pytest.fixture(scope="module")
def first() -> Plan:
    return plan(EXAMPLES["minimal"]())


def on_schedule(made: Plan, elapsed_s: float, silent: str | None = None) -> Sample:
    slot = int(elapsed_s // made.scenario.slot_duration_s) - made.first_slot
    where = {uav: path[slot] for uav, path in made.trajectories_m.items()}
    return Sample(elapsed_s, where, frozenset(uav for uav in where if uav != silent))


def test_on_schedule_users_get_what_the_plan_promised(first: Plan) -> None:
    samples = [on_schedule(first, 5.0 * n + 2) for n in range(4)]
    table = rates_by_slot([InForce(0.0, first)], samples, 4)
    assert table == pytest.approx(np.array([first.user_rates_bps[user] for user in first.scenario.user_ids]))


def test_a_silent_uav_serves_nobody_and_interferes_with_nobody(first: Plan) -> None:
    both = rates_by_sample([InForce(0.0, first)], [on_schedule(first, 1.0)])[0]
    one = rates_by_sample([InForce(0.0, first)], [on_schedule(first, 1.0, silent="uav-2")])[0]
    served_by_2 = np.array([first.association[user][0] == "uav-2" for user in first.scenario.user_ids])
    assert one[served_by_2] == pytest.approx(0.0)
    helped = one[~served_by_2] - both[~served_by_2]
    assert (helped >= 0).all()
    assert helped.max() > 0


def test_each_sample_is_judged_by_the_plan_in_force_then(first: Plan) -> None:
    second = replan(first, failed=["uav-2"], at_slot=2)
    timeline = [InForce(0.0, first), InForce(11.0, second)]
    samples = [on_schedule(first, 10.5, silent="uav-2"), on_schedule(second, 11.5), on_schedule(second, 17.0)]
    table = rates_by_sample(timeline, samples)
    promised = np.array([second.user_rates_bps[user] for user in second.scenario.user_ids])
    assert table[1] == pytest.approx(promised[:, 0])
    assert table[2] == pytest.approx(promised[:, 1])
    assert table[0] == pytest.approx(rates_by_sample([InForce(0.0, first)], samples[:1])[0])


def test_slots_without_a_sample_are_unknown_not_zero(first: Plan) -> None:
    table = rates_by_slot([InForce(0.0, first)], [on_schedule(first, 2.0)], 4)
    assert np.isfinite(table[:, 0]).all()
    assert np.isnan(table[:, 1:]).all()
