"""Operations as they are flown: as planned, after a loss, after a loss and a replan."""

import numpy as np
import pytest

from skyfolio.planner import EXAMPLES, Channel, Plan, plan, replan
from skyfolio.planner.robustness.flown import flown_as_planned, planned_gains, replanned, without


@pytest.fixture(scope="module")
def made() -> Plan:
    fading = Channel(fading="sampled", seed=5)
    return plan(EXAMPLES["minimal"]().with_changes(channel=fading, slots=6), n_starts=4)


def table(made: Plan) -> np.ndarray:
    return np.array([made.user_rates_bps[user] for user in made.scenario.user_ids])


def test_undisturbed_rates_are_those_of_the_plan(made: Plan) -> None:
    assert flown_as_planned(made).rates_bps(planned_gains(made)) == pytest.approx(table(made))


def test_a_lost_uav_serves_nobody_and_no_longer_interferes(made: Plan) -> None:
    rates = without(flown_as_planned(made), ["uav-2"], 3).rates_bps(planned_gains(made))
    assert rates[:, :3] == pytest.approx(table(made)[:, :3])
    for k, user in enumerate(made.scenario.user_ids):
        for n in range(3, 6):
            if made.association[user][n] == "uav-2":
                assert rates[k, n] == 0.0
            else:
                assert rates[k, n] >= table(made)[k, n]
    assert rates[:, 3:].sum() > 0


def test_after_a_replan_the_rates_are_those_of_the_new_plan(made: Plan) -> None:
    lost = without(flown_as_planned(made), ["uav-1"], 2)
    new = replan(made, failed=["uav-1"], at_slot=3, n_starts=4)
    rates = replanned(lost, new, 3).rates_bps(planned_gains(made))
    assert rates[:, 3:] == pytest.approx(table(new))
    assert rates[:, :3] == pytest.approx(lost.rates_bps(planned_gains(made))[:, :3])


def test_an_error_of_position_changes_the_rates_as_the_distance_does(made: Plan) -> None:
    flown, gains = flown_as_planned(made), planned_gains(made)
    away = np.full(flown.paths_m.shape, 400.0)
    assert flown.rates_bps(gains, away).sum() < 0.5 * table(made).sum()
    assert flown.rates_bps(gains, np.zeros(away.shape)) == pytest.approx(table(made))
