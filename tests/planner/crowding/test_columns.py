"""Columns: what serving a user is worth, against the same in NumPy, interval by interval."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from skyfolio.planner.arrays import Array
from skyfolio.planner.crowding.columns import Links, Medium, worth_of_serving
from skyfolio.planner.crowding.field import Field
from skyfolio.planner.crowding.slots import Ground, ground_of, slot_of
from skyfolio.planner.crowding.standard import standard_repulsion
from skyfolio.planner.layouts import scattered
from skyfolio.planner.problem import problem_of
from skyfolio.planner.reach import squared_distance_range


def columns(medium: Medium, links: Links, k: int, ring: int, lowest: float) -> Array:
    """What class 0 can be worth to user k from a ring, for each interval of x from the least x on."""
    gain, power, scale = links.gain[0, k], links.power[0, k], links.scale[0, k]
    snr, share = gain / (medium.rings[ring] ** 2 + links.height2[0]), medium.share[ring]
    place = max(0.0, (np.log(snr) - medium.least_log) / medium.log_step)
    n = min(int(place), len(medium.logs) - 2)
    rate = scale * ((1.0 - (place - n)) * medium.logs[n] + (place - n) * medium.logs[n + 1])
    low, high = medium.levels[:-1], medium.levels[1:]
    pull = share * max(lowest, 0.0) / (high + power * share**2 * medium.at_zero - 1.0)
    price, feature = 0.5 * power * pull**2, share * power * pull
    bare = np.maximum(rate[:-1] + price * low, rate[1:] + price * high) - price
    worth: Array = np.minimum(rate[:-1], bare + 0.5 * feature**2 * medium.at_zero - feature * lowest)
    return worth[max(0, int(np.searchsorted(medium.levels, links.least[0, k])) - 1) :]


def lowest_of(medium: Medium, field: Array, k: int, ring: int) -> float:
    """The least that the field can be midway between user k and a UAV in the ring."""
    near = len(medium.share) - len(medium.low)
    if ring >= near:
        return float(field[4 + ring - near, k])
    slope, radius = np.hypot(field[1, k], field[2, k]) + medium.slope_error, medium.rings[ring + 1] / 2
    return float(field[0, k] - slope * radius - 0.5 * field[3, k] * radius**2 - medium.value_error)


def a_field(seed: int, n_uavs: int, n_users: int) -> tuple[Ground, Links, Field]:
    rng = np.random.default_rng(seed)
    scenario = scattered(n_uavs, n_users, 4, seed=seed % 1000)
    channel = scenario.channel.model_copy(update={"noise_dbm": float(rng.uniform(-80, -50))})
    problem = problem_of(scenario.with_changes(channel=channel))
    near2, far2 = squared_distance_range(problem)
    ground = ground_of(problem)
    slot = slot_of(problem, ground, 3, near2[:, :, 3], far2[:, :, 3])
    mass = rng.exponential(size=n_users) * rng.integers(0, 2, n_users) * 10 ** rng.uniform(-1, 1)
    return ground, slot.links, Field(ground, standard_repulsion(ground, slot), mass)


@settings(max_examples=30)
@given(st.integers(0, 2**31), st.integers(2, 8), st.integers(2, 15))
def test_a_user_is_worth_the_best_interval_of_the_rings_beyond(seed: int, n_uavs: int, n_users: int) -> None:
    ground, links, field = a_field(seed, n_uavs, n_users)
    medium, rings = field.medium, len(ground.rings) - 1
    for nearest in (False, True):
        worth, feature, bare = (np.empty((1, n_users, rings)) for _ in range(3))
        worth_of_serving(medium, links, field.at_users, nearest, worth, feature, bare)
        for k in range(n_users):
            best = [columns(medium, links, k, i, lowest_of(medium, field.at_users, k, i)).max() for i in range(rings)]
            wanted = np.maximum(np.maximum.accumulate(best[::-1])[::-1], 0.0)
            got = worth[0, k, :1] if nearest else worth[0, k]
            np.testing.assert_allclose(got, wanted[: len(got)], rtol=1e-12)
        assert (feature[:, :, 0] >= 0.0).all()
        assert (bare[:, :, 0] >= worth[:, :, 0] * (1.0 - 1e-12)).all()
