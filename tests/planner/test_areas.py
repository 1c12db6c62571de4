"""Large fleets by areas: as good as planning at once where that can run, never worse for a round, and flyable."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skyfolio.planner import Channel, MaxIterations, Pins, Utility, plan, violations
from skyfolio.planner.areas.ceiling import slot_ceilings_kbps
from skyfolio.planner.areas.partition import cut, waves
from skyfolio.planner.fast import flyable, linked, served_rates_bps
from skyfolio.planner.layouts import laid_out
from skyfolio.planner.problem import problem_of


@pytest.mark.parametrize(("kind", "mu"), [("sum", 0.0), ("sum", -0.01), ("per_user", -0.1), ("pooled", -0.1)])
def test_areas_come_within_one_per_cent_of_planning_at_once(kind: str, mu: float) -> None:
    scenario = laid_out(
        "clustered", 30, 200, 40, seed=2, utility=Utility.model_validate({"kind": kind, "mu_per_kbps": mu})
    )
    at_once, apart = plan(scenario), plan(scenario, method="areas")
    assert violations(apart) == []
    assert apart.summary.utility_bps >= 0.99 * at_once.summary.utility_bps
    assert at_once.summary.utility_bps <= apart.summary.upper_bound_bps
    gained = [one.utility_bps for one in apart.history]
    assert gained == sorted(gained)
    assert gained[-1] == pytest.approx(apart.summary.utility_bps)


def test_no_uav_is_in_two_problems_that_are_planned_at_the_same_time() -> None:
    areas = cut(np.random.default_rng(1).uniform(0.0, 5000.0, (200, 2)), turn=1)
    assert sorted(np.concatenate([area.own for area in areas]).tolist()) == list(range(200))
    for wave in waves(areas):
        together = np.concatenate([area.uavs for area in wave])
        assert len(set(together.tolist())) == len(together)


@settings(max_examples=10)
@given(seed=st.integers(0, 10_000), speed=st.floats(0.0, 1.0))
def test_no_flight_exceeds_the_ceiling_of_a_slot(seed: int, speed: float) -> None:
    problem = problem_of(laid_out("uniform", 6, 30, 6, seed=seed % 5))
    rng = np.random.default_rng(seed)
    wish = problem.hover() + speed * np.cumsum(rng.normal(0.0, 20.0, (6, 6, 2)), axis=1)
    solution = linked(problem, flyable(problem, wish))
    rates_kbps = served_rates_bps(problem, solution) / 1e3
    assert (rates_kbps.sum(axis=0) <= slot_ceilings_kbps(problem, rates_kbps) + 1e-9).all()


def test_sampled_fading_and_pins_are_refused_by_name() -> None:
    scenario = laid_out("uniform", 4, 10, 3, seed=1)
    with pytest.raises(ValueError, match="fading"):
        plan(scenario.with_changes(channel=Channel(fading="sampled")), method="areas", stop=MaxIterations(1))
    with pytest.raises(ValueError, match="pins"):
        plan(scenario, method="areas", pins=Pins(uavs=("uav-1",)), stop=MaxIterations(1))
