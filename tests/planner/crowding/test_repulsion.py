"""Kappa: positive definite, below 1 / phi, and what a pair of UAVs costs is never less than it says."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import j0

from skyfolio.planner.arrays import Array
from skyfolio.planner.crowding.fit import bell
from skyfolio.planner.crowding.repulsion import (
    FREQUENCIES,
    RINGS,
    STEP,
    Repulsion,
    frequencies,
    phi,
    psi,
    repulsion_of,
    waves_of,
)

SPAN = 14.0


def random_repulsion(seed: int) -> Repulsion:
    rng = np.random.default_rng(seed)
    weight = rng.exponential(size=FREQUENCIES) ** 2 * rng.integers(0, 2, FREQUENCIES)
    weight[rng.integers(FREQUENCIES)] = 1.0
    return repulsion_of(weight, SPAN)


def exact(repulsion: Repulsion, distance: Array) -> Array:
    values: Array = j0(np.multiply.outer(distance, frequencies(SPAN))) @ repulsion.weight
    return values


@given(st.integers(0, 2**31))
def test_kappa_is_a_minorant_and_touches_what_it_is_below(seed: int) -> None:
    repulsion = random_repulsion(seed)
    distance = np.random.default_rng(seed).uniform(0, SPAN, 3000)
    assert (exact(repulsion, distance) * phi(distance)).max() <= 1.0
    everywhere = np.arange(0, SPAN, 0.002)
    assert (exact(repulsion, everywhere) * phi(everywhere)).max() > 0.9


@given(st.integers(0, 2**31))
def test_kappa_is_positive_definite(seed: int) -> None:
    repulsion = random_repulsion(seed)
    point = np.random.default_rng(seed).uniform(0, SPAN / 2**0.5, (30, 2))
    gram = exact(repulsion, np.linalg.norm(point[:, None] - point[None], axis=2))
    assert np.linalg.eigvalsh(gram).min() >= -1e-9 * repulsion.at_zero * 30


@given(st.integers(0, 2**31), st.floats(0.0, 3.0))
def test_a_pair_costs_at_least_what_its_features_say_wherever_the_uavs_are(seed: int, near: float) -> None:
    """Of users, UAVs, prices, gains and least distances at random; `near` leaves some UAVs right above their users."""
    repulsion, rng, n = random_repulsion(seed), np.random.default_rng(seed), 2000
    user = rng.uniform(0, SPAN / 2**0.5, (2, n, 2)) * rng.integers(0, 2, n)[:, None]
    uav = user + rng.normal(size=(2, n, 2)) * near * rng.random((2, n, 1)) ** 3
    price, gain = 10 ** rng.uniform(-3, 3, (2, n)), 10 ** rng.uniform(0, 3, (2, n))
    away = np.linalg.norm(uav - user, axis=2)
    ring = np.maximum(np.searchsorted(RINGS, away * rng.integers(0, 2, (2, n)), side="right") - 1, 0)
    across = np.linalg.norm(uav[::-1] - user, axis=2)
    cost = (price * gain[::-1] * (1 + away**2) / ((1 + RINGS[ring] ** 2) * (1 + across**2))).sum(axis=0)
    feature = np.sqrt(repulsion.room[ring] * 2.0 * price * gain)
    apart = np.linalg.norm(user[0] - user[1], axis=1)
    assert (feature[0] * feature[1] * exact(repulsion, apart) <= cost * (1 + 1e-12)).all()


def test_two_uavs_on_either_side_of_their_users_cost_no_more_than_phi_says() -> None:
    for distance in (0.3, 1.0, 4.0):
        r = (np.sqrt(distance**2 + 4) - distance) / 2
        assert phi(np.array(distance)) == pytest.approx((1 + (distance + r) ** 2) / (1 + r**2))
        beside = np.linspace(0, 10, 2001)
        ratio = (1 + (distance + beside) ** 2) / (1 + beside**2)
        assert ratio.max() == pytest.approx(float(phi(np.array(distance))), rel=1e-5)
        for least in (0.2, 1.5):
            assert ratio[beside >= least].max() == pytest.approx(float(psi(least, np.array(distance))), rel=1e-2)


def test_who_must_be_far_from_a_user_leaves_more_room() -> None:
    repulsion = repulsion_of(bell(10.0, SPAN), SPAN)
    share = repulsion.room * (1.0 + RINGS**2)
    assert repulsion.room[0] == pytest.approx(1.0, rel=1e-3)
    assert share[RINGS > 3.0].min() > 2.0


@given(st.integers(0, 2**31))
def test_tables_are_off_by_no_more_than_they_say(seed: int) -> None:
    repulsion, rng = random_repulsion(seed), np.random.default_rng(seed)
    distance = rng.uniform(0, SPAN - 2 * STEP, 500)
    entry = (distance / STEP).astype(int)
    part = distance / STEP - entry
    between = (1 - part) * repulsion.value[entry] + part * repulsion.value[entry + 1]
    assert (np.abs(between - exact(repulsion, distance)) <= repulsion.value_error).all()
    assert len(repulsion.value) == len(waves_of(SPAN)) > SPAN / STEP + 1
