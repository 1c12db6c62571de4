"""Plans of scenarios without any of the fields that came after the letter's users: the same to the last bit.

The golden file was written by the planner before it knew tracks, windows, weights and demands. Another processor rounds
sums in another order, so that bits are compared on the kind of processor that wrote the file, and values elsewhere.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from typing import Any

import pytest
from llvmlite.binding import get_host_cpu_name

from skyfolio.planner import Plan, Scenario, Utility, letter, plan, replan
from skyfolio.planner.examples import paper
from skyfolio.planner.layouts import laid_out

GOLDEN: dict[str, Any] = json.loads((Path(__file__).parent / "golden" / "plans.json").read_text())


def _paper(kind: str, mu: float) -> Scenario:
    return paper().with_changes(utility=Utility.model_validate({"kind": kind, "mu_per_kbps": mu}))


def _expected() -> Scenario:
    channel = paper().channel.model_copy(update={"fading": "expected", "draws": 8})
    return paper().with_changes(channel=channel)


def _least_rates() -> Scenario:
    users = tuple(user.model_copy(update={"min_rate_bps": 2000.0}) for user in paper().users)
    return paper().with_changes(users=users)


def _crowd(kind: str) -> Scenario:
    pooled = Utility(kind="pooled", mu_per_kbps=-0.3)
    if kind == "pooled":
        return laid_out("clustered", 6, 40, 8, seed=3, utility=pooled)
    return laid_out("uniform", 6, 40, 8, seed=3)


CASES: dict[str, Callable[[], Plan]] = {
    "letter": lambda: plan(paper(), n_starts=4),
    "letter, mu 0": lambda: plan(_paper("sum", 0.0), n_starts=4),
    "letter, per_user": lambda: plan(_paper("per_user", -0.3), n_starts=3),
    "letter, pooled": lambda: plan(_paper("pooled", -0.3), n_starts=3),
    "letter, sampled": lambda: plan(letter(fading="sampled"), n_starts=3),
    "letter, expected": lambda: plan(_expected(), n_starts=2),
    "letter, least rates": lambda: plan(_least_rates(), n_starts=2),
    "40 users, pooled": lambda: plan(_crowd("pooled"), n_starts=2),
    "40 users, sum": lambda: plan(_crowd("sum"), n_starts=3),
    "replan": lambda: replan(plan(paper(), n_starts=2), failed=["uav-3"], at_slot=7),
    "replan, little change": lambda: replan(
        plan(paper(), n_starts=2), failed=["uav-3"], at_slot=7, disruption_weight=5.0
    ),
    "replan, per_user": lambda: replan(plan(_paper("per_user", -0.3), n_starts=2), failed=["uav-1"], at_slot=7),
}


@pytest.mark.parametrize("name", CASES)
def test_a_plan_without_the_new_fields_is_what_it_was(name: str) -> None:
    made, was = CASES[name](), GOLDEN["plans"][name]
    assert made.id == was["id"]
    if get_host_cpu_name() != GOLDEN["processor"]:
        assert made.summary.utility_bps == pytest.approx(was["utility_bps"], rel=2e-3)
        return
    tables = made.model_dump(mode="json", include={"trajectories_m", "association", "bandwidth_hz", "user_rates_bps"})
    assert sha256(json.dumps(tables, sort_keys=True).encode()).hexdigest() == was["sha256"]
    for measure in ("utility_bps", "mean_sum_rate_bps", "upper_bound_bps", "jain"):
        assert getattr(made.summary, measure) == was[measure]
