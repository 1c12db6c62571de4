"""Base stations that are silent in some slots serve and disturb nobody in these."""

from __future__ import annotations

import numpy as np

from skyfolio.planner import EXAMPLES
from skyfolio.planner.heard import on_air_of
from skyfolio.planner.problem import problem_of
from skyfolio.planner.remainder import remaining
from skyfolio.planner.scenario import Scenario
from skyfolio.planner.sinr import spectral_efficiency
from tests.planner.test_feasibility import hovering

MINIMAL = EXAMPLES["minimal"]()


def silent(**slots: int) -> Scenario:
    """The minimal scenario, of four slots and two UAVs, in which uav-2 sends in some slots only."""
    first, second = MINIMAL.uavs
    return MINIMAL.with_changes(uavs=(first, second.model_copy(update=slots)))


def test_a_base_station_sends_from_one_slot_on_and_before_another() -> None:
    assert on_air_of(MINIMAL).all()
    assert on_air_of(silent(on_air_from_slot=2))[1].tolist() == [False, False, True, True]
    assert on_air_of(silent(on_air_from_slot=1, off_air_from_slot=3))[1].tolist() == [False, True, True, False]
    assert on_air_of(silent(leaves_at_slot=3, off_air_from_slot=4))[1].tolist() == [True, True, True, False]
    assert not on_air_of(silent(off_air_from_slot=0))[1].any()


def test_a_silent_one_neither_serves_nor_disturbs() -> None:
    quiet, loud = problem_of(silent(on_air_from_slot=2)), problem_of(MINIMAL)
    there, before = spectral_efficiency(quiet, quiet.hover()), spectral_efficiency(loud, loud.hover())
    assert (there[1, :, :2] == 0.0).all()
    assert (there[0, :, :2] > before[0, :, :2]).all()
    np.testing.assert_array_equal(there[:, :, 2:], before[:, :, 2:])


def test_a_replan_goes_on_counting_these_slots_on_its_own_grid() -> None:
    planned = hovering(silent(on_air_from_slot=2, off_air_from_slot=3))
    later, _ = remaining(planned, (), 1)
    assert (later.uavs[1].on_air_from_slot, later.uavs[1].off_air_from_slot) == (1, 2)
    last, _ = remaining(planned, (), 3)
    assert (last.uavs[1].on_air_from_slot, last.uavs[1].off_air_from_slot) == (0, 0)
