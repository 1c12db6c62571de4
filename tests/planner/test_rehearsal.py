"""After the rehearsal no plan or replan compiles anything: what is new in the kernels must be rehearsed too.

In a process of its own, because what other tests compiled would hide what is missing. What must not happen is a new
signature of a kernel that Python calls, compiled or loaded: nothing of it depends on what is on disk.
"""

import json
import subprocess
import sys
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numba.core.dispatcher import Dispatcher

from skyfolio.planner import METHODS, Changes, Pins, Plan, ReplanError, Scenario, Uav, User, Utility, plan, replan
from skyfolio.planner.branch_and_bound import certificate
from skyfolio.planner.fast import linked
from skyfolio.planner.problem import problem_of
from skyfolio.planner.rehearsal import rehearse
from skyfolio.planner.scenario import NoFlyDisc, NoFlyPolygon
from skyfolio.planner.stopping import MaxIterations
from skyfolio.planner.tracks import are_plain
from skyfolio.planner.unreachable import UnreachableEndError

ROOT = Path(__file__).resolve().parents[2]
AREA_M = ((0.0, 0.0), (400.0, 300.0))
DISC = NoFlyDisc(center_m=(200.0, 150.0), radius_m=20.0)
POLYGON = NoFlyPolygon(vertices_m=((300.0, 200.0), (340.0, 200.0), (340.0, 240.0)))


def scenario(
    *, uavs: int, users: int, slots: int, kind: str, mu: float, fading: str, constrained: tuple[bool, bool, bool]
) -> Scenario:
    zones, ends, rates = constrained
    return Scenario.model_validate(
        {
            "origin": {"lat_deg": 47.0, "lon_deg": 8.0},
            "area_m": AREA_M,
            "slots": slots,
            "slot_duration_s": 5.0,
            "altitude_m": 50.0,
            "min_separation_m": 4.0,
            "uavs": [
                Uav(
                    id=f"uav-{n}",
                    start_m=(30.0 + 70.0 * n, 40.0),
                    max_speed_mps=8.0,
                    end_m=(30.0 + 70.0 * n, 60.0) if ends else None,
                    leaves_at_slot=slots - 1 if ends and n == 1 and slots > 2 else None,
                    altitude_m=70.0 if n == 1 else None,
                )
                for n in range(uavs)
            ],
            "users": [
                User(id=f"user-{n}", position_m=(20.0 + 37.0 * n % 380, 91.0 * n % 280), min_rate_bps=50.0 * rates)
                for n in range(users)
            ],
            "channel": {"fading": fading, "seed": 3},
            "utility": Utility.model_validate({"kind": kind, "mu_per_kbps": mu}),
            "no_fly": (DISC, POLYGON) if zones else (),
        }
    )


def matrix() -> list[Scenario]:
    """Every utility, at mu < 0 and mu = 0, mean and sampled, with and without each constraint, and the odd sizes."""
    utilities = [("sum", -0.1), ("per_user", -0.1), ("pooled", -0.1), ("pooled", 0.0)]
    sizes = [(1, 1, 1), (1, 1, 4), (2, 1, 4), (1, 3, 4), (3, 5, 4), (4, 3, 2), (2, 4, 1)]
    constraints = [(False, False, False), (True, False, False), (False, True, False), (False, False, True), (True,) * 3]
    made = [
        (3, 5, 4, kind, mu, fading, limits)
        for (kind, mu), fading, limits in product(utilities, ("mean", "sampled"), constraints)
    ]
    made += [
        (*size, kind, mu, fading, (False, False, False))
        for size, (kind, mu), fading in product(sizes, utilities, ("mean", "sampled"))
    ]
    scenarios = [
        scenario(uavs=u, users=k, slots=n, kind=kind, mu=mu, fading=fading, constrained=limits)
        for u, k, n, kind, mu, fading, limits in made
    ]
    return [*scenarios, *map(beyond_the_letter, scenarios[::7])]


BEYOND: tuple[dict[str, Any], ...] = (
    {"demand_bps": 3000.0},
    {"velocity_mps": (1.0, 0.5), "uncertainty_mps": 0.2},
    {"leaves_at_slot": 2},
    {"weight": 2.0},
)


def beyond_the_letter(plain: Scenario) -> Scenario:
    """The same with users that move, leave, count twice or ask for no more than some rate."""
    changed = (user.model_copy(update=BEYOND[k % len(BEYOND)]) for k, user in enumerate(plain.users))
    return plain.with_changes(users=tuple(changed))


def changes_of(made: Plan) -> list[dict[str, Any]]:
    """What may have happened in flight."""
    first, *others = made.scenario.uav_ids
    new = User(id="new", position_m=(200.0, 40.0))
    back = Uav(id="back", start_m=(350.0, 30.0))
    asked: list[dict[str, Any]] = [
        {"failed": [first]} if others else {},
        {"positions_m": {uav: (40.0 + 60.0 * n, 55.0) for n, uav in enumerate(made.scenario.uav_ids)}},
        {"changes": Changes(users_joined=(new,))},
        {"changes": Changes(returned=(back,))},
        {"changes": Changes(utility=Utility(kind="per_user", mu_per_kbps=-0.2), bandwidth_hz={first: 5_000.0})},
        {"achieved_rates_bps": {user: [10.0] for user in made.scenario.user_ids}},
        {"n_starts": 9},
        {"disruption_weight": 0.5},
        {"pins": Pins(uavs=(first,), associations={made.scenario.user_ids[0]: first})},
    ]
    return asked


def everything() -> int:
    """Plan and replan all of it, by every method; how many plans were made."""
    count = 0
    for wanted in matrix():
        try:
            made = plan(wanted, n_starts=2, stop=MaxIterations(2))
        except (ValueError, UnreachableEndError):
            continue  # a small one that cannot reach its end
        count += 1
        problem = problem_of(wanted)
        fixed = np.asfortranarray([made.trajectories_m[uav] for uav in wanted.uav_ids])
        fixed.flags.writeable = False
        linked(problem, fixed)
        if len(wanted.uavs) <= 3:
            rates = np.array([made.user_rates_bps[user] for user in wanted.user_ids]) / 1e3
            certificate(problem, np.asfortranarray(rates), max_nodes=4)
        for method in METHODS.keys() - {"fast", "paper"}:
            if method != "areas" or (wanted.channel.fading == "mean" and are_plain(wanted)):
                plan(wanted, method=method, n_starts=2, stop=MaxIterations(2))
        if wanted.slots > 1:
            for asked in changes_of(made):
                try:
                    replan(made, at_slot=1, **{"n_starts": 2, "stop": MaxIterations(2), **asked})
                    count += 1
                except (ReplanError, ValueError):
                    continue  # not possible in this one
    return count


def signatures() -> dict[str, int]:
    """How many signatures each kernel that Python calls has by now."""
    return {
        f"{module.__name__}.{name}": len(kernel.signatures)
        for module in list(sys.modules.values())
        if module is not None and getattr(module, "__name__", "").startswith("skyfolio.planner")
        for name, kernel in vars(module).items()
        if isinstance(kernel, Dispatcher)
        and kernel.py_func.__module__ == module.__name__
        and not kernel.targetoptions.get("no_cpython_wrapper")
    }


def main() -> None:
    """The signatures after the rehearsal, and after everything."""
    rehearse()
    rehearsed = signatures()
    count = everything()
    json.dump({"rehearsed": rehearsed, "after": signatures(), "plans": count}, sys.stdout)


@pytest.fixture(scope="module")
def told() -> dict[str, Any]:
    code = "import skyfolio; from tests.planner.test_rehearsal import main; main()"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-3000:]
    said: dict[str, Any] = json.loads(done.stdout)
    return said


def test_plans_and_replans_of_every_kind_compile_nothing_after_the_rehearsal(told: dict[str, Any]) -> None:
    assert told["plans"] > 300
    grown = {name: (told["rehearsed"].get(name, 0), n) for name, n in told["after"].items()}
    assert {name: counts for name, counts in grown.items() if counts[0] != counts[1]} == {}


def test_the_rehearsal_calls_every_kernel_that_python_calls(told: dict[str, Any]) -> None:
    assert len(told["rehearsed"]) >= 8
    assert [name for name, count in told["rehearsed"].items() if count != 1 and not name.startswith(INNER)] == []


INNER = "skyfolio.planner.cells._"
"""Kernels that only kernels call, compiled with a wrapper for Python all the same."""
