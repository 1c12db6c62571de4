"""Eqs. (1)-(4): distances, SINR and counter-based fading."""

import numpy as np
import pytest

from skyfolio.planner import EXAMPLES
from skyfolio.planner.channel import fading_gains, squared_distances, sum_of_others
from skyfolio.planner.problem import problem_of
from skyfolio.planner.scenario import Channel
from skyfolio.planner.sinr import spectral_efficiency

SAMPLED = Channel(fading="sampled", seed=5, rician_k_db=3.0)


def test_distance_is_that_of_eq_1_with_each_uavs_own_altitude() -> None:
    paths = np.array([[[0.0, 0.0]], [[3.0, 0.0]]])
    users = np.array([[[3.0, 4.0]]])
    assert squared_distances(paths, users, np.array([10.0, 2.0]), np.zeros((1, 1)))[:, 0, 0].tolist() == [125.0, 20.0]


def test_efficiency_is_that_of_eq_4_written_out() -> None:
    problem = problem_of(EXAMPLES["minimal"]())
    paths = problem.hover()
    k, n = 2, 1
    snr = [
        problem.snr_gain[u, k, n] / (((paths[u, n] - problem.user_m[k, 0]) ** 2).sum() + problem.altitude_m[u] ** 2)
        for u in range(2)
    ]
    expected = [np.log2(1 + snr[0] / (snr[1] + 1)), np.log2(1 + snr[1] / (snr[0] + 1))]
    assert spectral_efficiency(problem, paths)[:, k, n] == pytest.approx(expected, rel=1e-12)


def test_the_snr_gain_is_power_times_reference_gain_over_noise() -> None:
    problem = problem_of(EXAMPLES["paper"]())
    assert np.unique(problem.snr_gain) == pytest.approx(0.1 * 0.01 / 10 ** (-8 - 3), rel=1e-12)


def test_sum_of_others_loses_nothing_beside_a_dominant_entry() -> None:
    values = np.array([[1e20], [1.0], [2.0]])
    assert sum_of_others(values)[:, 0].tolist() == [3.0, 1e20, 1e20]


def test_mean_fading_is_one_everywhere() -> None:
    assert (fading_gains(Channel(), ["a"], ["b", "c"], 3, 4) == np.ones((1, 2, 4))).all()


def test_rician_gains_have_mean_one_and_the_variance_of_their_factor() -> None:
    gains = fading_gains(SAMPLED, [f"uav-{u}" for u in range(10)], [f"user-{k}" for k in range(100)], 0, 100)
    rician = 10 ** (SAMPLED.rician_k_db / 10)
    error = 4 / np.sqrt(gains.size)
    assert gains.min() > 0
    assert gains.mean() == pytest.approx(1.0, abs=error)
    assert gains.var() == pytest.approx((1 + 2 * rician) / (1 + rician) ** 2, abs=5 * error)
    assert abs(np.corrcoef(gains[0].ravel(), gains[1].ravel())[0, 1]) < 4 / np.sqrt(gains[0].size)
    assert abs(np.corrcoef(gains[:, :, :-1].ravel(), gains[:, :, 1:].ravel())[0, 1]) < error


def test_a_draw_depends_on_its_key_alone() -> None:
    all_slots = fading_gains(SAMPLED, ["a", "b", "c"], ["x", "y"], 0, 10)
    survivors = fading_gains(SAMPLED, ["c", "a"], ["y"], 4, 6)
    assert (survivors == all_slots[[2, 0]][:, [1], 4:]).all()
    other_seed = fading_gains(SAMPLED.model_copy(update={"seed": 6}), ["a", "b", "c"], ["x", "y"], 0, 10)
    assert not np.isclose(other_seed, all_slots).any()


def test_a_held_draw_is_that_of_slot_0_in_every_slot_and_after_a_replan() -> None:
    held = SAMPLED.model_copy(update={"fading": "held"})
    first = fading_gains(SAMPLED, ["a", "b"], ["x", "y"], 0, 1)
    assert (fading_gains(held, ["a", "b"], ["x", "y"], 0, 5) == first).all()
    assert (fading_gains(held, ["b"], ["y", "x"], 3, 2) == first[[1]][:, [1, 0]]).all()


def test_a_uav_that_has_left_sends_nothing() -> None:
    scenario = EXAMPLES["minimal"]()
    leaving = (scenario.uavs[0].model_copy(update={"leaves_at_slot": 2}), scenario.uavs[1])
    problem = problem_of(scenario.with_changes(uavs=leaving))
    efficiency = spectral_efficiency(problem, problem.hover())
    assert (efficiency[0, :, 2:] == 0).all()
    assert (efficiency[0, :, :2] > 0).all()
    assert (efficiency[1, :, 2] > efficiency[1, :, 1]).all(), "its interference is gone too"
