"""Kappa: positive definite, below 1 / (1 + D^2), and its tables say what they claim."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import j0

from skyfolio.planner.arrays import Array
from skyfolio.planner.crowding.repulsion import STEP, Repulsion, repulsion_of, rings_until

SPAN = 14.0


def random_repulsion(seed: int) -> Repulsion:
    rng = np.random.default_rng(seed)
    frequency = np.sort(rng.uniform(0, 2.5, int(rng.integers(1, 12))))
    return repulsion_of(frequency, rng.exponential(size=len(frequency)) ** 2, SPAN, rings_until(SPAN))


def exact(repulsion: Repulsion, distance: Array) -> Array:
    values: Array = j0(np.multiply.outer(distance, repulsion.frequency)) @ repulsion.weight
    return values


@given(st.integers(0, 2**31))
def test_kappa_is_a_minorant_and_touches_what_it_is_below(seed: int) -> None:
    repulsion = random_repulsion(seed)
    distance = np.random.default_rng(seed).uniform(0, SPAN, 3000)
    share = exact(repulsion, distance) * (1 + distance**2)
    assert share.max() <= 1.0
    assert (exact(repulsion, np.arange(0, SPAN, 0.002)) * (1 + np.arange(0, SPAN, 0.002) ** 2)).max() > 0.9


@given(st.integers(0, 2**31))
def test_kappa_is_positive_definite(seed: int) -> None:
    repulsion = random_repulsion(seed)
    point = np.random.default_rng(seed).uniform(0, SPAN / 2**0.5, (30, 2))
    gram = exact(repulsion, np.linalg.norm(point[:, None] - point[None], axis=2))
    assert np.linalg.eigvalsh(gram).min() >= -1e-9 * repulsion.at_zero * 30


@given(st.integers(0, 2**31))
def test_the_shares_leave_room_for_both_uavs_to_be_beside_their_users(seed: int) -> None:
    repulsion, rng = random_repulsion(seed), np.random.default_rng(seed)
    one, other = rng.integers(0, len(repulsion.share), (2, 2000))
    distance = rng.uniform(0, SPAN, 2000) * rng.integers(0, 2, 2000) ** 2
    beside = (repulsion.rings[one + 1] + repulsion.rings[other + 1]) / 2
    kept = repulsion.share[one] * repulsion.share[other] * exact(repulsion, distance)
    assert (kept <= 1.0 / (1.0 + distance**2 + beside**2) + 1e-12).all()


@given(st.integers(0, 2**31))
def test_tables_are_off_by_no_more_than_they_say(seed: int) -> None:
    repulsion, rng = random_repulsion(seed), np.random.default_rng(seed)
    distance = rng.uniform(0, SPAN - 2 * STEP, 500)
    entry = (distance / STEP).astype(int)
    part = distance / STEP - entry
    between = (1 - part) * repulsion.value[entry] + part * repulsion.value[entry + 1]
    assert (np.abs(between - exact(repulsion, distance)) <= repulsion.value_error).all()
    for row, edge in zip(repulsion.low, repulsion.rings[-len(repulsion.low) :], strict=True):
        nearby = np.clip(distance + rng.uniform(-edge / 2, edge / 2, 500), 0, SPAN)
        assert (np.minimum(row[entry], row[entry + 1]) <= exact(repulsion, nearby) + 1e-12).all()


@given(st.integers(0, 2**31), st.floats(0, 6.28), st.floats(0, 0.5))
def test_a_field_falls_no_faster_than_its_slope_and_bend_allow(seed: int, direction: float, away: float) -> None:
    repulsion = random_repulsion(seed)
    distance = np.random.default_rng(seed).uniform(0.01, SPAN - 1.0, 300)
    entry = (distance / STEP).astype(int)
    slope = (repulsion.slope[entry] + repulsion.slope[entry + 1]) / 2
    bend = np.maximum(repulsion.bend[entry], repulsion.bend[entry + 1])
    moved = np.hypot(distance + away * np.cos(direction), away * np.sin(direction))
    least = exact(repulsion, distance) + slope * away * np.cos(direction) - bend * away**2 / 2
    third = float(repulsion.weight @ repulsion.frequency**2)
    assert (least <= exact(repulsion, moved) + STEP * third * away + 1e-12).all()


def test_far_rings_end_where_no_user_can_be_farther() -> None:
    assert rings_until(3.0)[-1] == pytest.approx(3.0)
    assert (np.diff(rings_until(40.0)) > 0).all()
