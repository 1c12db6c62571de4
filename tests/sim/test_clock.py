"""sim.clock"""

import math

import pytest

from skyfolio.sim.clock import ScaledClock, VirtualClock


def test_a_scaled_clock_starts_at_zero_and_runs_speedup_times_as_fast() -> None:
    wall = iter([100.0, 100.0, 103.0])
    clock = ScaledClock(10.0, source=lambda: next(wall))
    assert clock.now() == 0.0
    assert clock.now() == 30.0


@pytest.mark.parametrize("speedup", [0.0, -1.0, math.nan, math.inf])
def test_a_speedup_that_is_not_positive_is_refused_by_name(speedup: float) -> None:
    with pytest.raises(ValueError, match="speedup must be a positive number"):
        ScaledClock(speedup)


def test_a_virtual_clock_moves_only_when_it_is_moved() -> None:
    clock = VirtualClock(5.0)
    assert clock.now() == clock.now() == 5.0
    assert clock.advance(2.5) == clock.now() == 7.5


@pytest.mark.parametrize("seconds", [-0.1, math.nan, math.inf])
def test_a_virtual_clock_never_runs_backwards(seconds: float) -> None:
    with pytest.raises(ValueError, match="forward only"):
        VirtualClock().advance(seconds)
