"""Every kind against the formulas and tables of its source, written out once more with plain numbers."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from skyfolio.planner.channels.aerial_3gpp import Aerial3gpp
from skyfolio.planner.channels.antennas import Beam, Dipole
from skyfolio.planner.channels.kinds import channel_of
from skyfolio.planner.channels.los_probability import LosProbability
from skyfolio.planner.channels.radio import RadioChannel
from skyfolio.planner.channels.rician import Channel


def gain_db(channel: RadioChannel, away_m: float, height_m: float) -> float:
    return 10.0 * math.log10(channel.gain_at(away_m, height_m))


def test_the_letters_gain_is_the_reference_gain_over_the_squared_distance() -> None:
    assert Channel().gain_at(30.0, 40.0) == pytest.approx(0.01 / 2500.0, rel=1e-12)


@pytest.mark.parametrize(
    ("environment", "a", "b", "los_db", "nlos_db"),
    [  # Al-Hourani et al. 2014, table II at 2 GHz, and a, b of eq. (5)
        ("suburban", 4.88, 0.43, 0.1, 21.0),
        ("urban", 9.61, 0.16, 1.0, 20.0),
        ("dense_urban", 12.08, 0.11, 1.6, 23.0),
        ("highrise", 27.23, 0.08, 2.3, 34.0),
    ],
)
@pytest.mark.parametrize(("away_m", "height_m"), [(0.0, 60.0), (60.0, 60.0), (500.0, 60.0), (120.0, 250.0)])
def test_the_loss_by_elevation_is_that_of_al_hourani(
    environment: Any, a: float, b: float, los_db: float, nlos_db: float, away_m: float, height_m: float
) -> None:
    theta = 90.0 if away_m == 0.0 else math.degrees(math.atan(height_m / away_m))
    probability = 1.0 / (1.0 + a * math.exp(-b * (theta - a)))  # eq. (5)
    distance_m = math.hypot(away_m, height_m)
    free_db = 20.0 * math.log10(4.0 * math.pi * 2e9 * distance_m / 299_792_458.0)
    loss_db = free_db + probability * los_db + (1.0 - probability) * nlos_db  # eqs. (6)-(8)
    assert gain_db(LosProbability(environment=environment), away_m, height_m) == pytest.approx(-loss_db, abs=1e-9)


def test_at_45_degrees_an_urban_link_has_line_of_sight_in_97_of_100_places() -> None:
    channel = LosProbability(environment="urban")
    assert channel.los_probability(np.array([80.0]), np.array([80.0]))[0] == pytest.approx(0.967692, abs=1e-6)


def test_given_excess_losses_replace_those_of_the_surroundings() -> None:
    given = LosProbability(environment="urban", excess_los_db=0.0, excess_nlos_db=0.0, carrier_hz=1e9)
    free_db = 20.0 * math.log10(4.0 * math.pi * 1e9 * 500.0 / 299_792_458.0)
    assert gain_db(given, 300.0, 400.0) == pytest.approx(-free_db, abs=1e-9)


def mean_db(probability: float, los_db: float, nlos_db: float) -> float:
    return 10.0 * math.log10(probability * 10 ** (-los_db / 10) + (1.0 - probability) * 10 ** (-nlos_db / 10))


@pytest.mark.parametrize(("away_m", "height_m"), [(10.0, 50.0), (100.0, 50.0), (900.0, 50.0), (700.0, 25.0)])
def test_an_urban_macro_link_is_that_of_tr_36_777(away_m: float, height_m: float) -> None:
    p1 = 4300.0 * math.log10(height_m) - 3800.0  # table B-1, UMa-AV, 22.5 m < h_UT <= 100 m
    d1 = max(460.0 * math.log10(height_m) - 700.0, 18.0)
    probability = 1.0 if away_m <= d1 else d1 / away_m + math.exp(-away_m / p1) * (1.0 - d1 / away_m)
    d3 = math.hypot(away_m, height_m)
    los = 28.0 + 22.0 * math.log10(d3) + 20.0 * math.log10(2.0)  # table B-2
    nlos = -17.5 + (46.0 - 7.0 * math.log10(height_m)) * math.log10(d3) + 20.0 * math.log10(40.0 * math.pi * 2.0 / 3.0)
    assert nlos > los
    assert gain_db(Aerial3gpp(), away_m, height_m) == pytest.approx(mean_db(probability, los, nlos), abs=1e-9)


def test_above_a_hundred_metres_an_urban_macro_link_is_always_in_sight() -> None:
    los = 28.0 + 22.0 * math.log10(math.hypot(3000.0, 120.0)) + 20.0 * math.log10(3.5)
    assert gain_db(Aerial3gpp(carrier_hz=3.5e9), 3000.0, 120.0) == pytest.approx(-los, abs=1e-9)


@pytest.mark.parametrize(("away_m", "height_m"), [(10.0, 50.0), (100.0, 50.0), (900.0, 150.0)])
def test_an_urban_micro_link_is_that_of_tr_36_777(away_m: float, height_m: float) -> None:
    p1 = 233.98 * math.log10(height_m) - 0.95  # table B-1, UMi-AV, 22.5 m < h_UT <= 300 m
    d1 = max(294.05 * math.log10(height_m) - 432.94, 18.0)
    probability = 1.0 if away_m <= d1 else d1 / away_m + math.exp(-away_m / p1) * (1.0 - d1 / away_m)
    d3, log_f = math.hypot(away_m, height_m), 20.0 * math.log10(2.0)
    free = 20.0 * math.log10(40.0 * math.pi * 2.0 * d3 / 3.0)
    los = max(free, 30.9 + (22.25 - 0.5 * math.log10(height_m)) * math.log10(d3) + log_f)  # table B-2
    nlos = max(los, 32.4 + (43.2 - 7.6 * math.log10(height_m)) * math.log10(d3) + log_f)
    channel = Aerial3gpp(environment="UMi-AV")
    assert gain_db(channel, away_m, height_m) == pytest.approx(mean_db(probability, los, nlos), abs=1e-9)


@pytest.mark.parametrize(("away_m", "height_m"), [(10.0, 20.0), (2500.0, 20.0), (2500.0, 39.0), (900.0, 150.0)])
def test_a_rural_macro_link_is_that_of_tr_36_777(away_m: float, height_m: float) -> None:
    p1 = max(15021.0 * math.log10(height_m) - 16053.0, 1000.0)  # table B-1, RMa-AV, 10 m < h_UT <= 40 m
    d1 = max(1350.8 * math.log10(height_m) - 1602.0, 18.0)
    probability = 1.0 if away_m <= d1 or height_m > 40 else d1 / away_m + math.exp(-away_m / p1) * (1.0 - d1 / away_m)
    d3 = math.hypot(away_m, height_m)
    at_1m = 20.0 * math.log10(40.0 * math.pi * 0.7 / 3.0)
    los = max(23.9 - 1.8 * math.log10(height_m), 20.0) * math.log10(d3) + at_1m  # table B-2
    nlos = max(los, -12.0 + (35.0 - 5.3 * math.log10(height_m)) * math.log10(d3) + at_1m)
    channel = Aerial3gpp(environment="RMa-AV", carrier_hz=7e8)
    assert gain_db(channel, away_m, height_m) == pytest.approx(mean_db(probability, los, nlos), abs=1e-9)


@pytest.mark.parametrize(
    ("below_deg", "gain_dbi"),
    [(90.0, 8.0), (57.5, 5.0), (25.0, -4.0), (0.0, 8.0 - 20.0), (-30.0, 8.0 - 20.0)],  # TR 36.814, table A.2.1.1-2
)
def test_a_beam_loses_3_db_half_a_beamwidth_off_its_axis(below_deg: float, gain_dbi: float) -> None:
    beam = Beam(tilt_deg=90.0, beamwidth_deg=65.0, side_lobe_db=20.0, gain_dbi=8.0)
    assert 10 * np.log10(beam.gain(np.deg2rad(below_deg))) == pytest.approx(gain_dbi, abs=1e-9)


def test_a_dipole_has_2_dbi_at_the_horizon_and_its_null_straight_down() -> None:
    dipole = Dipole(null_db=20.0)
    assert 10 * np.log10(dipole.gain(np.array(0.0))) == pytest.approx(2.157, abs=0.001)  # Balanis, eq. 4-94
    at_45 = 1.643 * (math.cos(math.pi / 2 * math.sqrt(0.5)) / math.sqrt(0.5)) ** 2  # eq. 4-84
    assert dipole.gain(np.array(math.pi / 4)) == pytest.approx(0.99 * at_45 + 0.01643, rel=1e-9)
    assert dipole.gain(np.array(math.pi / 2)) == pytest.approx(0.01643, rel=1e-9)


def test_an_antenna_adds_its_gain_to_every_kind() -> None:
    for kind in ("rician", "los_probability", "3gpp_uav"):
        plain, aimed = channel_of({"kind": kind}), channel_of({"kind": kind, "antenna": {"kind": "beam"}})
        assert gain_db(aimed, 0.0, 60.0) - gain_db(plain, 0.0, 60.0) == pytest.approx(8.0, abs=1e-9)
        assert gain_db(aimed, 1e5, 60.0) - gain_db(plain, 1e5, 60.0) == pytest.approx(-12.0, abs=1e-9)


def test_a_noise_figure_is_noise_in_the_band_of_each_uav() -> None:
    noise = channel_of({"noise_figure_db": 9.0}).noise_w(np.array([180e3, 10e6]))
    dbm = 10.0 * np.log10(noise) + 30.0
    assert dbm == pytest.approx([-174.0 + 52.5527 + 9.0, -174.0 + 70.0 + 9.0], abs=1e-3)
