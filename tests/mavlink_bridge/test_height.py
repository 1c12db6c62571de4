"""How high a UAV is, and whether it came down so fast that it hit the ground."""

from __future__ import annotations

import pytest

from skyfolio.mavlink_bridge.height import Height


def heard(*positions: tuple[float, float]) -> Height:
    """Positions at 5 Hz: metres up, metres per second down."""
    height = Height()
    for number, (up_m, sinking_mps) in enumerate(positions):
        fields = {"relative_alt": up_m * 1000, "vz": sinking_mps * 100, "time_boot_ms": number * 200}
        height.hear(fields, number * 0.2)
    return height


def test_one_that_is_too_low_to_brake_hits_the_ground() -> None:
    assert heard((5.1, 9.8), (2.9, 11.8), (0.4, 13.7), (0.0, 0.0)).hit_mps == pytest.approx(12.5, abs=0.1)


def test_a_dive_that_can_still_be_braked_hits_nothing() -> None:
    assert heard((6.4, 7.0), (5.0, 7.0), (3.6, 7.0), (2.4, 5.0), (2.0, 0.0)).hit_mps is None


def test_a_steep_landing_hits_nothing() -> None:
    assert heard((2.0, 5.0), (1.0, 5.0), (0.2, 4.0), (0.0, 0.0)).hit_mps is None


@pytest.mark.parametrize("wrong", [(0.5, 0.0), (10.0, 12.0)], ids=["height", "speed"])
def test_a_speed_and_a_height_that_contradict_each_other_are_no_hit(wrong: tuple[float, float]) -> None:
    assert heard((10.0, 0.0), wrong).hit_mps is None


def test_one_that_is_up_again_has_hit_nothing() -> None:
    assert heard((10.0, 0.0), (0.5, 12.0), (10.0, 0.0)).hit_mps is None
