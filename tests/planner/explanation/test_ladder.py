"""The ladder from what a user gets to what a UAV overhead and alone would give it."""

import numpy as np
import pytest

from skyfolio.planner import Plan, Scenario, plan
from skyfolio.planner.explanation.ladder import STEPS, ladders
from skyfolio.planner.explanation.ledger import Ledger
from skyfolio.planner.layouts import LAYOUTS, laid_out
from skyfolio.planner.scenario import Channel, NoFlyDisc


def obstructed(layout: str, seed: int) -> Scenario:
    """Zones over three users, two UAVs that leave, one that must be at its start in the end, sampled fading."""
    scenario = laid_out(layout, 4, 12, 10, seed=seed)
    starts = [uav.start_m for uav in scenario.uavs]
    zones = [
        NoFlyDisc(center_m=user.position_m, radius_m=25.0)
        for user in scenario.users[:3]
        if min(np.hypot(e - user.position_m[0], n - user.position_m[1]) for e, n in starts) > 30.0
    ]
    first, second, third, *others = scenario.uavs
    uavs = (
        first.model_copy(update={"leaves_at_slot": 4}),
        second.model_copy(update={"leaves_at_slot": 7}),
        third.model_copy(update={"end_m": third.start_m}),
        *others,
    )
    return scenario.with_changes(uavs=uavs, no_fly=tuple(zones), channel=Channel(fading="sampled", seed=seed))


@pytest.mark.parametrize("layout", sorted(LAYOUTS))
def test_no_rung_is_below_the_one_before(layout: str) -> None:
    for seed in range(3):
        made = plan(obstructed(layout, seed), n_starts=2)
        ledger = Ledger.of(made)
        found = ladders(ledger, np.arange(12))
        assert sorted(found) == list(range(12))
        for ladder in found.values():
            assert len(ladder.rungs_kbps) == len(STEPS) + 1
            assert np.diff(ladder.rungs_kbps).min() >= -1e-9


def with_one_uav_elsewhere(made: Plan, rng: np.random.Generator) -> tuple[int, np.ndarray]:
    """Another feasible path of one UAV: a random walk within its speed and the area."""
    scenario = made.scenario
    u = int(rng.integers(len(scenario.uavs)))
    step = scenario.uavs[u].max_speed_mps * scenario.slot_duration_s
    heading = rng.uniform(0, 2 * np.pi)
    path = [np.array(scenario.uavs[u].start_m)]
    for _ in range(scenario.slots - 1):
        heading += rng.normal(0, 0.4)
        here = path[-1] + step * np.array([np.cos(heading), np.sin(heading)])
        path.append(np.clip(here, scenario.area_m[0], scenario.area_m[1]))
    return u, np.array(path)


def test_no_other_path_of_a_single_uav_gives_a_user_more_than_the_rung_of_distance() -> None:
    rng = np.random.default_rng(5)
    made = plan(laid_out("uniform", 3, 9, 10, seed=4))
    ledger = Ledger.of(made)
    found = ladders(ledger, np.arange(9))
    at = STEPS.index("distance") + 1
    for _ in range(200):
        u, path_m = with_one_uav_elsewhere(made, rng)
        snr = ledger.snr_of(u, path_m)
        interfering = 1.0 + ledger.total_snr - ledger.snr_of(u)
        whole = made.scenario.uavs[u].bandwidth_hz / 1e3 * np.log2(1.0 + snr / interfering)
        for k, ladder in found.items():
            assert whole[k].mean() <= ladder.rungs_kbps[at] * (1 + 1e-9)


def test_the_ledger_of_a_plan_has_its_utility_and_its_rates() -> None:
    made = plan(laid_out("two_towns", 3, 9, 10, seed=2))
    ledger = Ledger.of(made)
    assert ledger.utility_kbps(ledger.rates_kbps) * 1e3 == pytest.approx(made.summary.utility_bps)
    rates = ledger.bandwidth_hz / 1e3 * np.log2(1.0 + ledger.own_snr / (1.0 + ledger.total_snr - ledger.own_snr))
    assert rates == pytest.approx(ledger.rates_kbps)
