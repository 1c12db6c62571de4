"""Rates at positions that are not the plan's, for the slots that are asked for and no others."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from skyfolio.planner import EXAMPLES, Channel, delivered_rates_bps, plan
from skyfolio.planner import delivered as module
from skyfolio.planner.channel import fading_gains


def test_a_sample_costs_its_own_slot_and_gets_what_it_gets_among_all_others(monkeypatch: pytest.MonkeyPatch) -> None:
    made = plan(EXAMPLES["minimal"]().with_changes(channel=Channel(fading="sampled", seed=3)))
    slots = np.array([3, 0, 2, 2, 1], dtype=np.intp)
    paths = np.array([made.trajectories_m[uav] for uav in made.scenario.uav_ids])
    where = np.moveaxis(paths[:, slots], 0, 1) + np.arange(5.0)[:, None, None]
    on = np.ones((5, 2), dtype=bool)
    drawn: list[int] = []

    def counted(*args: Any) -> NDArray[np.float64]:
        drawn.append(args[-1])
        return fading_gains(*args)

    together = delivered_rates_bps(made, slots, where, on)
    monkeypatch.setattr(module, "fading_gains", counted)
    for row in range(5):
        alone = delivered_rates_bps(made, slots[row : row + 1], where[row : row + 1], on[row : row + 1])
        np.testing.assert_allclose(alone[0], together[row], rtol=1e-12)
    assert drawn == [1] * 5
    assert delivered_rates_bps(made, slots[:0], where[:0], on[:0]).shape == (0, len(made.scenario.users))
