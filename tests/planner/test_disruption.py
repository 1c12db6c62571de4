"""Replans that change little: priced, reported, and never more disruptive at a higher price."""

from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from skyfolio.planner import EXAMPLES, Changes, Pins, Plan, ReplanError, Uav, Utility, plan, replan, violations
from skyfolio.planner.disruption import METRES_PER_USER
from skyfolio.planner.layouts import scattered

WEIGHTS = (0.0, 0.01, 0.3, 1.0, 3.0, 10.0, 100.0, 1e6)


@pytest.fixture(scope="module")
def paper() -> Plan:
    return plan(EXAMPLES["paper"](), n_starts=3)


def amount(made: Plan) -> float:
    """What the weight is multiplied with."""
    assert made.disruption is not None
    return made.disruption.user_slots_changed / made.scenario.slots + made.disruption.path_changed_m / METRES_PER_USER


def counted_by_hand(old: Plan, new: Plan, at_slot: int) -> tuple[int, set[str], float]:
    """User-slots with another server, whose, and mean metres off the old paths, from the plans' own tables."""
    count = 0
    users: set[str] = set()
    for user in new.scenario.user_ids:
        for n in range(new.scenario.slots):
            before, after = old.association[user][at_slot + n], new.association[user][n]
            served = old.bandwidth_hz[user][at_slot + n] > 0 or new.bandwidth_hz[user][n] > 0
            if before in new.trajectories_m and before != after and served:
                count, users = count + 1, users | {user}
    metres = 0.0
    for uav, path in new.trajectories_m.items():
        metres += sum(
            np.hypot(*np.subtract(a, b)) for a, b in zip(path, old.trajectories_m[uav][at_slot:], strict=True)
        )
    return count, users, metres / new.scenario.slots


@pytest.mark.parametrize("weight", [0.0, 2.0])
def test_what_a_replan_changes_is_reported_as_counted_by_hand_and_priced(paper: Plan, weight: float) -> None:
    again = replan(paper, failed=["uav-3"], at_slot=5, disruption_weight=weight)
    count, users, metres = counted_by_hand(paper, again, 5)
    told = again.disruption
    assert told is not None
    assert (told.user_slots_changed, told.users_changed) == (count, len(users))
    assert told.path_changed_m == pytest.approx(metres)
    assert told.price_bps == pytest.approx(weight * 1e3 * amount(again))
    assert metres > 0.0


def test_a_weight_of_zero_changes_nothing(paper: Plan) -> None:
    asked: dict[str, Any] = {"failed": ["uav-3"], "at_slot": 5, "n_starts": 3}
    assert replan(paper, **asked, disruption_weight=0.0) == replan(paper, **asked)


@pytest.mark.parametrize("kind", ["sum", "per_user", "pooled"])
@pytest.mark.parametrize("seed", range(4))
def test_more_weight_changes_less_and_a_very_large_one_nothing(kind: str, seed: int) -> None:
    scenario = scattered(4, 9, 8, seed=seed)
    scenario = scenario.with_changes(utility=Utility.model_validate({"kind": kind, "mu_per_kbps": -0.05}))
    old = plan(scenario, n_starts=2)
    made = [
        replan(old, failed=[scenario.uav_ids[seed % 4]], at_slot=2, disruption_weight=weight, n_starts=3)
        for weight in WEIGHTS
    ]
    assert [violations(one) for one in made] == [[]] * len(WEIGHTS)
    amounts = [amount(one) for one in made]
    assert all(after <= before + 2e-3 for before, after in pairwise(amounts[1:])), amounts
    assert amounts[1] <= amounts[0] + 0.05, "at hardly any price the climb may go on where it stopped without one"
    assert amounts[0] > 0.0
    assert amounts[-1] < 1e-9  # metres: adding up steps rounds
    for uav, path in made[-1].trajectories_m.items():
        assert np.allclose(path, old.trajectories_m[uav][2:], rtol=0.0, atol=1e-9)


def test_the_price_buys_what_it_is_worth(paper: Plan) -> None:
    """At each weight, the plans chosen at other weights are worth hardly more once their change is priced."""
    made = {w: replan(paper, failed=["uav-3"], at_slot=5, disruption_weight=w) for w in WEIGHTS[1:]}
    for weight, chosen in made.items():
        worth = {w: one.summary.utility_bps / 1e3 - weight * amount(one) for w, one in made.items()}
        assert worth[weight] >= max(worth.values()) - 1e-4 * abs(worth[weight]), chosen.disruption


@pytest.mark.parametrize("seed", [0, 4])
def test_no_weight_leaves_minimum_rates_unmet_that_another_plan_meets(seed: int) -> None:
    scenario = scattered(3, 5, 10, seed=seed)
    needy = tuple(user.model_copy(update={"min_rate_bps": 8_000.0}) for user in scenario.users)
    old = plan(scenario.with_changes(users=needy, utility=Utility(kind="per_user", mu_per_kbps=-0.05)), n_starts=2)
    asked: dict[str, Any] = {"failed": ["uav-2"], "at_slot": 2}
    unmet = [
        sum(map(len, made.unmet_min_rate_slots.values()))
        for made in (
            replan(old, **asked, pins=Pins(uavs=("uav-1", "uav-3"))),
            replan(old, **asked),
            replan(old, **asked, disruption_weight=1e6),
        )
    ]
    assert unmet[2] <= unmet[1] < unmet[0]


def test_pins_hold_at_any_weight_and_users_of_returning_uavs_are_counted(paper: Plan) -> None:
    without = replan(paper, failed=["uav-3"], at_slot=4, n_starts=1)
    back = Uav(id="uav-3", start_m=(300.0, 200.0))
    pins = Pins(uavs=("uav-1",), associations={"user-1": "uav-3"})
    for weight in (0.0, 1.0, 1e6):
        again = replan(
            without, at_slot=8, changes=Changes(returned=(back,)), pins=pins, disruption_weight=weight, n_starts=2
        )
        assert set(again.association["user-1"]) == {"uav-3"}
        assert again.trajectories_m["uav-1"] == without.trajectories_m["uav-1"][4:]
        assert violations(again) == []


def test_changes_are_counted_by_the_plan_in_force_where_a_uav_returns_to_the_first_plan(paper: Plan) -> None:
    without = replan(paper, failed=["uav-3"], at_slot=4, n_starts=2)
    here = {"uav-3": (300.0, 200.0), **{uav: without.trajectories_m[uav][4] for uav in ("uav-1", "uav-2")}}
    back = replan(paper, at_slot=8, positions_m=here, in_force=without, disruption_weight=1e6, n_starts=2)
    assert back.disruption is not None
    assert back.disruption.users_changed == 0
    for uav in ("uav-1", "uav-2"):
        assert np.allclose(back.trajectories_m[uav], without.trajectories_m[uav][4:], rtol=0.0, atol=1e-9)
    by_first = replan(paper, at_slot=8, positions_m=here, disruption_weight=1e6, n_starts=2)
    assert not np.allclose(by_first.trajectories_m["uav-1"][-1], without.trajectories_m["uav-1"][-1], atol=1e-3)


@pytest.mark.parametrize("weight", [-1.0, float("nan"), float("inf")])
def test_a_weight_is_a_finite_number_of_at_least_zero(paper: Plan, weight: float) -> None:
    with pytest.raises(ReplanError, match=r"disruption_weight: .* must be a finite number of kbit/s, at least 0"):
        replan(paper, failed=["uav-3"], at_slot=5, disruption_weight=weight)


def test_only_the_default_method_has_a_price(paper: Plan) -> None:
    with pytest.raises(ValueError, match="disruption_weight: only the method 'fast' has one, not 'static'"):
        replan(paper, failed=["uav-3"], at_slot=5, method="static", disruption_weight=1.0)
