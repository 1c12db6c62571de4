"""A replan under a price is a local optimum of what is priced: nothing near it, and nothing tiny, is worth more."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from skyfolio.planner import EXAMPLES, Pins, Plan, Uav, User, Utility, fast, plan, replan, violations
from skyfolio.planner.arrays import Array
from skyfolio.planner.disruption import Former, amount_of, disruption_of, former_of
from skyfolio.planner.problem import Problem, problem_of
from skyfolio.planner.remainder import remaining
from skyfolio.planner.solution import Solution
from skyfolio.planner.utility import utility_kbps

KINDS = (("sum", 0.0), ("sum", -0.1), ("per_user", -0.1), ("pooled", -0.1))
CLOSE = 2e-4
"""Relative: what the gentle beginning of the price and the stopping rules may leave."""


class Case:
    """A plan, its replan at a price, and the worth of any other replan by the same measure."""

    def __init__(self, old: Plan, failed: str, at_slot: int, weight: float, **options: Any) -> None:
        self.made = replan(old, failed=[failed], at_slot=at_slot, disruption_weight=weight, **options)
        scenario, past = remaining(old, [failed], at_slot, options.get("positions_m"))
        self.problem: Problem = problem_of(scenario, past)
        self.former: Former = former_of(old, scenario, at_slot, set(scenario.uav_ids), weight)
        index = {uav: u for u, uav in enumerate(scenario.uav_ids)}
        self.solution = Solution(
            np.array([self.made.trajectories_m[uav] for uav in scenario.uav_ids]),
            np.array([[index[uav] for uav in self.made.association[user]] for user in scenario.user_ids]),
            np.array([self.made.bandwidth_hz[user] for user in scenario.user_ids]),
            [],
        )

    def worth(self, solution: Solution) -> float:
        """Utility less price, kbit/s, from the planner's independent measures."""
        rates = fast.served_rates_bps(self.problem, solution) / 1e3
        utility = utility_kbps(self.problem.counted_kbps(rates), self.problem.kind, self.problem.mu)
        amount = amount_of(disruption_of(self.former, solution), self.problem.n_slots)
        return utility - self.former.weight_kbps * amount

    def best_links(self, paths_m: Array) -> float:
        """The best worth at these paths among all servers of every user in one slot after the other, and as made."""
        solution = replace(self.solution, paths_m=paths_m)
        best = self.worth(solution)
        for n in range(self.problem.n_slots):
            for row in product(range(self.problem.n_uavs), repeat=self.problem.n_users):
                serving = self.solution.serving.copy()
                serving[:, n] = row
                for bands in self._bands(paths_m, serving, n):
                    best = max(best, self.worth(replace(solution, serving=serving, bandwidth_hz=bands)))
        return best

    def _bands(self, paths_m: Array, serving: NDArray[np.intp], n: int) -> Iterator[Array]:
        """Shares of the bands in slot n: whole ones under `sum`, else those that suit the servers best."""
        if self.problem.kind == "sum" or self.problem.mu == 0.0:
            for chosen in product(range(-1, self.problem.n_users), repeat=self.problem.n_uavs):
                bands = self.solution.bandwidth_hz.copy()
                bands[:, n] = 0.0
                if all(k < 0 or serving[k, n] == u for u, k in enumerate(chosen)):
                    for u, k in enumerate(chosen):
                        if k >= 0:
                            bands[k, n] = self.problem.bandwidth_hz[u]
                    yield bands
            return
        yield fast.linked(replace(self.problem, pinned_to=serving.astype(np.intp)), paths_m).bandwidth_hz


def small(kind: str, mu: float, seed: int, *, uavs: int = 3, users: int = 3, slots: int = 5) -> Plan:
    """A plan of a few UAVs and users in a square of 300 m, so noisy that places matter."""
    rng = np.random.default_rng(seed)
    example = EXAMPLES["minimal"]()
    scenario = example.with_changes(
        area_m=((0.0, 0.0), (300.0, 300.0)),
        slots=slots,
        slot_duration_s=5.0,
        uavs=tuple(
            Uav(id=f"uav-{u}", start_m=(60.0 + 90.0 * u, float(rng.uniform(30, 270))), max_speed_mps=6.0)
            for u in range(uavs)
        ),
        users=tuple(
            User(id=f"user-{k}", position_m=(float(rng.uniform(0, 300)), float(rng.uniform(0, 300))))
            for k in range(users)
        ),
        channel=example.channel.model_copy(update={"noise_dbm": -60.0}),
        utility=Utility.model_validate({"kind": kind, "mu_per_kbps": mu}),
    )
    return plan(scenario, n_starts=4)


def nearby(case: Case, rng: np.random.Generator) -> Iterator[Array]:
    """Flyable paths near the replan's: one slot, the rest of a path, or all moved, or led back to the old ones."""
    here, former = case.solution.paths_m, case.former.paths_m
    old = np.where(np.isnan(former), here, former)
    for scale in (0.1, 1.0, 5.0, 20.0):
        for _ in range(12):
            one, rest, every = here.copy(), here.copy(), here.copy()
            u, n = int(rng.integers(len(here))), int(rng.integers(1, here.shape[1]))
            one[u, n] += rng.normal(scale=scale, size=2)
            rest[u, n:] += rng.normal(scale=scale, size=2)
            every += rng.normal(scale=scale, size=every.shape)
            for wanted in (one, rest, every):
                yield fast.flyable(case.problem, wanted)
    for share in (0.02, 0.1, 0.5, 1.0):
        yield fast.flyable(case.problem, here + share * (old - here))
        for u in range(len(here)):
            single = here.copy()
            single[u] += share * (old[u] - here[u])
            yield fast.flyable(case.problem, single)


@pytest.mark.parametrize(("kind", "mu"), KINDS)
@pytest.mark.parametrize("weight", [0.3, 2.0, 20.0])
@pytest.mark.parametrize("seed", [0, 1])
def test_no_plan_near_by_is_worth_more(kind: str, mu: float, weight: float, seed: int) -> None:
    old = small(kind, mu, seed)
    case = Case(old, "uav-0", 1, weight, n_starts=3)
    assert violations(case.made) == []
    here = case.worth(case.solution)
    assert case.made.disruption is not None
    assert here == pytest.approx((case.made.summary.utility_bps - case.made.disruption.price_bps) / 1e3)
    near = [case.worth(replace(case.solution, paths_m=path)) for path in nearby(case, np.random.default_rng(seed))]
    assert max(near) <= here + CLOSE * abs(here)
    assert case.best_links(case.solution.paths_m) <= here + CLOSE * abs(here)


@pytest.mark.parametrize(("kind", "mu"), KINDS)
@pytest.mark.parametrize("weight", [0.5, 3.0, 10.0])
def test_no_plan_on_a_grid_of_all_ways_is_worth_much_more(kind: str, mu: float, weight: float) -> None:
    """One UAV of two is left, blown 40 m off its path, for three slots: every way of steps in 16 directions."""
    old = small(kind, mu, 3, uavs=2, users=2, slots=4)
    east, north = old.trajectories_m["uav-1"][1]
    case = Case(old, "uav-0", 1, weight, n_starts=4, positions_m={"uav-1": (east - 30.0, north + 25.0)})
    angle = np.arange(16) * np.pi / 8
    steps = [np.zeros(2), *(share * 30.0 * np.array([np.cos(a), np.sin(a)]) for a in angle for share in (0.5, 1.0))]
    start = case.solution.paths_m[:, :1]
    best = -np.inf
    for first, second in product(steps, repeat=2):
        ways = np.stack([start[0, 0], start[0, 0] + first, start[0, 0] + first + second])[None]
        if (ways >= 0.0).all() and (ways <= 300.0).all():
            linked = fast.linked(case.problem, ways)
            best = max(best, case.worth(linked))
    here = case.worth(case.solution)
    assert here >= best - 1e-3 * abs(best)


def test_where_another_place_is_worth_its_metres_uavs_go_part_of_the_way() -> None:
    """At prices between those that buy everything and nothing, metres are bought as far as each is worth its price."""
    old = small("per_user", -0.1, 1)
    metres = []
    for weight in (0.1, 0.5, 1.0, 2.0, 4.0, 8.0, 1e6):
        made = replan(old, failed=["uav-0"], at_slot=1, disruption_weight=weight, n_starts=3)
        assert made.disruption is not None
        metres.append(made.disruption.path_changed_m)
    assert len({round(metre, 3) for metre in metres}) >= 4, metres
    assert metres[-1] < 1e-9


def test_pins_and_minimum_rates_hold_while_changes_are_weighed() -> None:
    old = small("pooled", -0.05, 4)
    needy = tuple(user.model_copy(update={"min_rate_bps": 300.0}) for user in old.scenario.users)
    scenario = old.scenario.with_changes(users=needy)
    for kind in ("sum", "pooled"):
        utility = Utility.model_validate({"kind": kind, "mu_per_kbps": -0.05})
        held = plan(scenario.with_changes(utility=utility), n_starts=3)
        free = replan(held, failed=["uav-0"], at_slot=1, n_starts=3)
        for weight in (0.3, 3.0):
            pins = Pins(uavs=("uav-1",), associations={"user-0": "uav-2"})
            made = replan(held, failed=["uav-0"], at_slot=1, disruption_weight=weight, pins=pins, n_starts=3)
            assert violations(made) == []
            assert set(made.association["user-0"]) == {"uav-2"}
            again = replan(held, failed=["uav-0"], at_slot=1, disruption_weight=weight, n_starts=3)
            assert sum(map(len, again.unmet_min_rate_slots.values())) <= sum(
                map(len, free.unmet_min_rate_slots.values())
            )
