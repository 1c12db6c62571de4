"""Tables of channels: near to the formulas, and bounds over intervals that hold for them and for the formulas."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skyfolio.planner.channels.bends import Bends, bends_of
from skyfolio.planner.channels.kinds import channel_of
from tests.planner.channels.any_kind import CHANNELS

LONGEST_M = 900.0
HEIGHTS_M = np.array([60.0, 150.0, 60.0])


def bends(name: str) -> Bends:
    made = bends_of(channel_of(CHANNELS[name]), HEIGHTS_M, LONGEST_M)
    assert made is not None
    return made


def test_the_letters_channel_has_no_tables() -> None:
    assert bends_of(channel_of({"noise_figure_db": 5.0}), HEIGHTS_M, LONGEST_M) is None


@pytest.mark.parametrize("name", CHANNELS)
def test_a_table_is_within_a_twentieth_of_a_decibel_of_the_formulas(name: str) -> None:
    away_m = np.broadcast_to(np.linspace(0.0, LONGEST_M, 20_001), (3, 20_001))
    exact = channel_of(CHANNELS[name]).factor(away_m, np.repeat(HEIGHTS_M[:, None], 20_001, axis=1))
    assert np.abs(10.0 * np.log10(bends(name).at(away_m**2) / exact)).max() < 0.05


@pytest.mark.parametrize("name", CHANNELS)
@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**31))
def test_no_gain_between_two_distances_is_outside_of_its_bounds(name: str, seed: int) -> None:
    rng, tables = np.random.default_rng(seed), bends(name)
    ends = np.sort(rng.choice([rng.uniform(0, 1200, (3, 5, 2)), rng.uniform(0, 3, (3, 5, 2))]), axis=2)
    height2 = HEIGHTS_M[:, None] ** 2
    near2, far2 = ends[..., 0] ** 2 + height2, ends[..., 1] ** 2 + height2
    most, least = tables.gain_range(near2, far2)
    for share in [0.0, 1.0, *rng.random(20)]:
        over2 = (ends[..., 0] + share * (ends[..., 1] - ends[..., 0])) ** 2
        gain = tables.at(over2) / (over2 + height2)
        assert (gain <= most * (1 + 1e-9)).all()
        assert (gain >= least * (1 - 1e-9)).all()


def test_bounds_of_one_distance_are_the_gain_there_nearly() -> None:
    for name in CHANNELS:
        d2 = np.full((3, 1), 80.0**2) + HEIGHTS_M[:, None] ** 2
        most, least = bends(name).gain_range(d2, d2)
        assert most == pytest.approx(least, rel=1e-9)


@pytest.mark.parametrize("name", [name for name in CHANNELS if not name.startswith("map")])
@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**31))
def test_bounds_over_distances_and_heights_hold_for_the_formulas(name: str, seed: int) -> None:
    rng, channel = np.random.default_rng(seed), channel_of(CHANNELS[name])
    away_m = np.sort(rng.uniform(0.0, 900.0, (50, 2)), axis=1)
    low_m, high_m = np.sort(rng.uniform(-5.0, 200.0, (50, 2)), axis=1).T
    nearest_h = np.where((low_m <= 0) & (high_m >= 0), 0.0, np.minimum(abs(low_m), abs(high_m)))
    near2 = np.maximum(away_m[:, 0] ** 2 + nearest_h**2, 1e-6)
    far2 = away_m[:, 1] ** 2 + np.maximum(abs(low_m), abs(high_m)) ** 2
    most, least = channel.gain_bounds(away_m[:, 0] ** 2, away_m[:, 1] ** 2, near2, far2, low_m, high_m)
    for _ in range(20):
        away = away_m[:, 0] + rng.random(50) * (away_m[:, 1] - away_m[:, 0])
        height = low_m + rng.random(50) * (high_m - low_m)
        gain = channel.factor(away, height) / np.maximum(away**2 + height**2, 1e-6)
        assert (gain <= most * (1 + 1e-9)).all()
        assert (gain >= least * (1 - 1e-9)).all()


@pytest.mark.parametrize("name", CHANNELS)
@given(seed=st.integers(0, 2**31))
@settings(max_examples=20, deadline=None)
def test_the_slope_is_the_derivative_of_the_factor(name: str, seed: int) -> None:
    rng, tables = np.random.default_rng(seed), bends(name)
    away = rng.uniform(1.0, 890.0, 200)
    place = away / tables.step_m[tables.row[1]]
    away = away[np.abs(place - np.round(place)) > 0.01]  # between entries it has one
    _, slope = tables.of_uav(1, away**2)
    apart = 1e-4
    ahead, behind = (tables.of_uav(1, (away + by) ** 2)[0] for by in (apart, -apart))
    by_square = (ahead - behind) / ((away + apart) ** 2 - (away - apart) ** 2)
    assert slope == pytest.approx(by_square, rel=1e-3, abs=1e-9 * float(np.abs(tables.factor).max()))
