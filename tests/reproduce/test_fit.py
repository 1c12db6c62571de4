"""The joint fit on settings made up by hand."""

from dataclasses import replace

import numpy as np
import pytest

from skyfolio.api.lab.reproduce.courses import Choices
from skyfolio.api.lab.reproduce.fit import TARGETS, Setting, Table, errors, fitted, held_out, misfits

LETTER = np.array(list(TARGETS.values()))
BASE = Setting.of(Choices(), "each in turn", "Baseline 2 (placed)", "1/(kbit/s)")


def test_a_setting_is_said_in_words() -> None:
    assert BASE.baseline_2 == "placed"
    assert BASE.planners_know == "the draw"
    assert BASE.users_per_uav == Choices().split
    mean = Setting.of(Choices(fading="mean", user_radius_m=None), "uav-1", "Baseline 2 (at the starts)", "1/(Mbit/s)")
    assert (mean.users, mean.draws, mean.planners_know) == ("anywhere", "none", "all")


def test_a_variance_counts_by_its_square_root_and_others_as_they_are() -> None:
    squared = np.array([measure == "variance" for _, measure in TARGETS])
    assert errors(LETTER * np.where(squared, 1.21, 1.1)) == pytest.approx(np.full(len(TARGETS), 0.1))
    assert misfits(LETTER * np.where(squared, 1.21, 1.1)) == pytest.approx(0.1)


def test_the_best_setting_is_found_and_a_choice_without_effect_is_not_told_apart() -> None:
    settings = [replace(BASE, noise=noise, users=users) for noise in ("a", "b") for users in ("near", "far")]
    near = np.array([[LETTER * 1.01, LETTER * 1.01]])
    wobble = np.array([[LETTER * 1.01, LETTER * 1.0]])  # noise b: better on one layout, worse on the other
    wobbly = np.array([[LETTER * 1.0, LETTER * 1.01]])
    far = near * 1.3
    found = fitted(Table(settings, np.concatenate([wobble, far, wobbly, far])))
    assert found["best"]["setting"]["users"] == "near"
    best_in = {row["value"]: row["best_in"] for row in found["told_apart"]["users"]}
    assert best_in == {"near": 1.0, "far": 0.0}
    assert all(0.1 < row["best_in"] < 0.9 for row in found["told_apart"]["noise"])
    assert {(row["choice"], row["value"]) for row in found["alone"]} == {("noise", "b"), ("users", "far")}


def test_a_held_out_number_has_no_say_in_its_own_prediction() -> None:
    right_but_for_the_first = LETTER.copy()
    right_but_for_the_first[0] *= 2.0
    fits_the_first_alone = LETTER * 1.5
    fits_the_first_alone[0] = LETTER[0]
    rows = held_out(np.array([right_but_for_the_first, fits_the_first_alone]))
    assert rows[0]["off"] == pytest.approx(1.0)
    assert rows[0]["predicted"] == pytest.approx(2 * LETTER[0])
