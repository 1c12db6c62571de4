"""Closest approach of UAVs that fly straight from slot to slot."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from skyfolio.planner import closest_approach
from skyfolio.planner.arrays import Array

two_paths = arrays(float, st.tuples(st.just(2), st.integers(1, 4), st.just(2)), elements=st.floats(-50, 50, width=32))


def test_uavs_that_swap_places_meet_between_the_slots() -> None:
    paths = np.array([[[0.0, 0.0], [10.0, 0.0]], [[10.0, 0.0], [0.0, 0.0]]])
    assert closest_approach(paths) == 0.0


def test_crossing_at_different_times_keeps_them_apart() -> None:
    paths = np.array([[[0.0, 0.0], [10.0, 0.0]], [[5.0, -5.0], [5.0, 15.0]]])
    assert closest_approach(paths) == pytest.approx(np.sqrt(5.0))


def test_one_uav_is_never_too_close() -> None:
    assert closest_approach(np.zeros((1, 3, 2))) == np.inf


def test_uavs_in_formation_keep_their_distance() -> None:
    path = np.cumsum(np.random.default_rng(0).normal(size=(1, 9, 2)), axis=1)
    assert closest_approach(np.concatenate([path, path + np.array([3.0, 4.0])])) == pytest.approx(5.0)


@given(two_paths)
def test_it_is_the_least_over_finely_sampled_flight(paths: Array) -> None:
    share = np.linspace(0, 1, 400)[:, None]
    apart = paths[0] - paths[1]
    legs = [apart[n] + share * (apart[n + 1] - apart[n]) for n in range(len(apart) - 1)] or [apart]
    sampled = min(float(np.linalg.norm(leg, axis=1).min()) for leg in legs)
    spacing = max((float(np.linalg.norm(np.diff(leg, axis=0), axis=1).max(initial=0.0)) for leg in legs), default=0.0)
    assert sampled - spacing - 1e-9 <= closest_approach(paths) <= sampled + 1e-9
