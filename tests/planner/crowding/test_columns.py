"""Columns: what serving a user is worth, against the same in NumPy, interval by interval."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from skyfolio.planner.arrays import Array
from skyfolio.planner.crowding.columns import Links, Medium, worth_of_serving
from skyfolio.planner.crowding.field import Field
from skyfolio.planner.crowding.fit import bell
from skyfolio.planner.crowding.repulsion import repulsion_of
from skyfolio.planner.crowding.slots import ground_of, slot_of
from skyfolio.planner.layouts import scattered
from skyfolio.planner.problem import problem_of
from skyfolio.planner.reach import squared_distance_range


def best_column(medium: Medium, links: Links, m: int, k: int, field: float) -> float:
    """What row m can be worth to user k: the greatest over the intervals of y, and beyond the last level."""
    power, scale = links.power[m, k] * medium.room[links.ring[m, k]], links.scale[m, k]
    place = max(0.0, (np.log(links.snr[m, k]) - medium.least_log) / medium.log_step)
    n = min(int(place), len(medium.logs) - 2)
    rate = scale * ((1.0 - (place - n)) * medium.logs[n] + (place - n) * medium.logs[n + 1])
    low, high = medium.levels[:-1], medium.levels[1:]
    pull = max(field, 0.0) / (high + power * medium.at_zero - 1.0)
    price, feature = 0.5 * power * pull**2, power * pull
    bare = np.maximum(rate[:-1] + price * low, rate[1:] + price * high) - price
    worth: Array = np.minimum(rate[:-1], bare + 0.5 * feature**2 * medium.at_zero - feature * field)
    first = max(0, int(np.searchsorted(medium.levels, links.least[m, k])) - 1)
    return float(max(worth[first:].max(), rate[-1]))


def a_field(seed: int, n_uavs: int, n_users: int) -> tuple[Links, Field]:
    rng = np.random.default_rng(seed)
    scenario = scattered(n_uavs, n_users, 4, seed=seed % 1000)
    channel = scenario.channel.model_copy(update={"noise_dbm": float(rng.uniform(-80, -50))})
    problem = problem_of(scenario.with_changes(channel=channel))
    near2, far2 = squared_distance_range(problem)
    ground = ground_of(problem)
    slot = slot_of(problem, ground, 3, near2[:, :, 3], far2[:, :, 3])
    mass = rng.exponential(size=n_users) * rng.integers(0, 2, n_users) * 10 ** rng.uniform(-1, 1)
    return slot.links, Field(ground, repulsion_of(bell(8.0, ground.span), ground.span), mass)


@settings(max_examples=30)
@given(st.integers(0, 2**31), st.integers(2, 8), st.integers(2, 15))
def test_a_user_is_worth_the_best_interval(seed: int, n_uavs: int, n_users: int) -> None:
    links, field = a_field(seed, n_uavs, n_users)
    medium = field.medium
    worth, feature, bare = (np.empty(links.snr.shape) for _ in range(3))
    worth_of_serving(medium, links, field.at_users, worth, feature, bare)
    asked = links.snr > 0.0
    assert np.isinf(links.least[~asked]).all()
    assert (worth[~asked] == 0.0).all()
    for m, k in np.argwhere(asked):
        wanted = best_column(medium, links, m, k, float(field.at_users[k] - medium.value_error))
        np.testing.assert_allclose(worth[m, k], wanted, rtol=1e-12)
    assert (feature >= 0.0).all()
    assert (bare >= worth * (1.0 - 1e-12)).all()
