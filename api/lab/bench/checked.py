"""The independent check on many random plans and replans.

`python -m skyfolio.api.lab.bench.checked [--hills] [--count 500] [--processes 2]`, or, without hills, as a part of
`skyfolio bench planner`.

Every plan passes it before it leaves the planner; here it is asked again of what came out, and plans that were refused
as not feasible, which would be defects, are counted too.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack
from multiprocessing import get_context
from typing import Any

import numpy as np

from skyfolio.api.lab.bench.hilly import judged, over_hills
from skyfolio.planner import (
    Channel,
    InfeasiblePlanError,
    MaxIterations,
    ReplanError,
    Scenario,
    UnreachableEndError,
    Utility,
    plan,
    replan,
    violations,
)
from skyfolio.planner.layouts import laid_out
from skyfolio.planner.scenario import NoFlyDisc

LAYOUTS = ("uniform", "clustered", "stadium", "corridor", "two_towns")
UTILITIES = (("sum", 0.0), ("sum", -0.05), ("per_user", -0.1), ("pooled", -0.5))
REFUSED = "refused"
MOST_UAVS, MOST_USERS, MOST_SLOTS = 8, 30, 12


def random_scenario(seed: int) -> Scenario:
    """Return a scenario with some of: ends, a UAV that leaves, a no-fly disc, a minimum rate, drawn fading, heights."""
    rng = np.random.default_rng(seed)
    n_uavs, n_users = int(rng.integers(2, MOST_UAVS + 1)), int(rng.integers(2, MOST_USERS + 1))
    n_slots = int(rng.integers(4, MOST_SLOTS + 1))
    kind, mu = UTILITIES[seed % len(UTILITIES)]
    utility = Utility.model_validate({"kind": kind, "mu_per_kbps": mu})
    easy = laid_out(LAYOUTS[seed % len(LAYOUTS)], n_uavs, n_users, n_slots, seed=seed, utility=utility)
    ends, leaves, heights, zone, floor, fading = rng.random(6) < 0.4
    uavs = tuple(
        uav.model_copy(
            update={
                **({"end_m": uav.start_m} if ends and u % 2 == 0 else {}),
                **({"leaves_at_slot": n_slots // 2 + 1} if leaves and u == n_uavs - 1 > 1 else {}),
                **({"altitude_m": 60.0 + 10.0 * u} if heights else {}),
            }
        )
        for u, uav in enumerate(easy.uavs)
    )
    least = {"min_rate_bps": 200.0} if floor else {}
    users = (easy.users[0].model_copy(update=least), *easy.users[1:])
    east, north = np.mean([uav.start_m for uav in uavs[:2]], axis=0)
    discs = (NoFlyDisc(center_m=(float(east), float(north)), radius_m=20.0),) if zone else ()
    noise_dbm = float(rng.choice([-80.0, -70.0, -60.0, -50.0]))
    channel = Channel(noise_dbm=noise_dbm, fading="sampled", seed=seed) if fading else Channel(noise_dbm=noise_dbm)
    return easy.with_changes(uavs=uavs, users=users, no_fly=discs, channel=channel)


def broken(seed: int) -> list[str]:
    """Return what is wrong with a plan of a random scenario, and with a replan after a loss half-way."""
    scenario = random_scenario(seed)
    try:
        made = plan(scenario, n_starts=4, stop=MaxIterations(4))
        rest = replan(made, failed=[scenario.uav_ids[0]], at_slot=scenario.slots // 2, stop=MaxIterations(4))
    except InfeasiblePlanError as error:
        return [str(error)]
    return [violation.message for one in (made, rest) for violation in violations(one)]


def broken_over_hills(seed: int) -> list[str]:
    """Return the same of a random scenario over hills, also by a judge that only looks at places a metre apart."""
    scenario = over_hills(random_scenario(seed), seed)
    gone, at_slot = scenario.uav_ids[0], scenario.slots // 2
    try:
        made = plan(scenario, n_starts=1, stop=MaxIterations(2))
        rest = replan(made, failed=[gone], at_slot=at_slot, n_starts=1, stop=MaxIterations(2))
    except UnreachableEndError as error:  # a refusal is no violation, but is told
        return [f"{REFUSED}: {error}"]
    except (InfeasiblePlanError, ReplanError) as error:
        return [str(error)]
    found = [violation.message for one in (made, rest) for violation in violations(one)]
    return [*found, *judged(made), *judged(rest)]


def checked(
    seeds: range,
    processes: int = 1,
    told: Callable[[int, int], None] = lambda _done, _broken: None,
    *,
    wrong_with: Callable[[int], list[str]] | None = None,
) -> dict[str, Any]:
    """Check the plans and replans of these scenarios, and return how many there were and what is wrong, by seed.

    told: called after each scenario with how many are done, and how many of those are broken. wrong_with: returns what
    is wrong with the plans of one seed (default: `broken`).
    """
    found: dict[str, list[str]] = {}
    with ExitStack() as stack:
        mapped: Callable[..., Iterator[list[str]]] = map
        if processes > 1:
            mapped = stack.enter_context(ProcessPoolExecutor(processes, mp_context=get_context("spawn"))).map
        for seed, wrong in zip(seeds, mapped(wrong_with or broken, seeds), strict=True):
            if wrong:
                found[str(seed)] = wrong
            told(seed - seeds.start + 1, len(found))
    return {"plans": len(seeds), "replans": len(seeds), "first_seed": seeds.start, "broken": found}


def main() -> None:
    """Check, and say what was found."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=500, help="scenarios; each is planned, and replanned after a loss")
    parser.add_argument("--seed", type=int, default=1, help="of the first scenario: where an interrupted check goes on")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--hills", action="store_true", help="over random hills, with altitudes")
    given = parser.parse_args()

    def told(done: int, n_broken: int) -> None:
        if done % 10 == 0:
            print(f"{done} of {given.count}, {n_broken} broken; next seed {given.seed + done}", file=sys.stderr)  # noqa: T201

    wrong_with = broken_over_hills if given.hills else broken
    found = checked(range(given.seed, given.seed + given.count), given.processes, told, wrong_with=wrong_with)
    refused = {seed: told for seed, told in found["broken"].items() if all(REFUSED in one for one in told)}
    wrong = {seed: told for seed, told in found["broken"].items() if seed not in refused}
    counts = f"{len(wrong)} with violations, {len(refused)} refused"
    print(f"{given.count} plans and {given.count} replans, {counts}", *found["broken"].items(), sep="\n")  # noqa: T201
    raise SystemExit(bool(wrong))


if __name__ == "__main__":
    main()
