"""Altitudes between their limits: what a change is worth is told without counting everybody anew."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from skyfolio.api.lab.bench.cases import instance
from skyfolio.api.lab.bench.hilly import hills
from skyfolio.planner.channel import squared_distances
from skyfolio.planner.channels.kinds import channel_of
from skyfolio.planner.fast import linked, served_rates_bps
from skyfolio.planner.ground import choosing
from skyfolio.planner.ground.aloft import raised
from skyfolio.planner.ground.choosing import chosen_altitudes
from skyfolio.planner.ground.ground import Ground, ground_of
from skyfolio.planner.ground.heard import Heard, heard
from skyfolio.planner.ground.links import seen_aloft
from skyfolio.planner.ground.room import room_over
from skyfolio.planner.problem import Problem, problem_of
from skyfolio.planner.scenario import Scenario
from skyfolio.planner.solution import Solution

KINDS = ("sum", "per_user")


def over_hills(kind: str, n_users: int = 20, **changes: object) -> tuple[Problem, Ground, Solution]:
    """Five UAVs over hills, their lowest altitudes, and links that are good at their starts."""
    level = instance((5, n_users, 8), kind)
    walking = level.users[0].model_copy(
        update={"positions_m": tuple((50.0 + 3.0 * n, 80.0) for n in range(level.slots)), "position_m": (50.0, 80.0)}
    )
    fields = {"users": (walking, *level.users[1:]), "altitude_min_m": 40.0, "altitude_max_m": 160.0, **changes}
    scenario: Scenario = level.with_changes(terrain=hills(level, np.random.default_rng(3)), clearance_m=30.0, **fields)
    problem, ground = problem_of(scenario), ground_of(scenario)
    assert ground is not None
    return problem, ground, raised(problem, ground, linked(problem, problem.hover()))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    "channel",
    [
        *({"fading": fading, "seed": 5} for fading in ("mean", "sampled", "expected")),
        {"antenna": {"kind": "beam", "beamwidth_deg": 40.0}},
        {"carrier_hz": 2e9, "noise_dbm": -60.0},
        {"kind": "3gpp_uav", "noise_figure_db": 9.0, "fading": "expected", "draws": 5},
    ],
    ids=["mean", "sampled", "expected", "beam", "hills diffract", "3gpp_uav"],
)
def test_rates_of_links_are_those_of_the_whole_problem_after_every_change(kind: str, channel: dict[str, Any]) -> None:
    problem, ground, solution = over_hills(kind, channel=channel_of(channel))
    assert solution.altitudes_m is not None
    altitudes_m, rng = solution.altitudes_m.copy(), np.random.default_rng(1)
    links = heard(problem, ground, solution, altitudes_m)
    for u in (0, 3, 0, 4, 1, 2):
        before = links.of(u, altitudes_m[u])
        altitudes_m[u] += rng.uniform(0.0, 100.0, size=problem.n_slots)
        links.own, links.others = links.with_one(u, before, links.of(u, altitudes_m[u]))
        seen = seen_aloft(problem, ground, solution.paths_m, altitudes_m)
        told = links.table(links.rates_kbps(links.own, links.others))
        assert told == pytest.approx(served_rates_bps(seen, solution) / 1e3, rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_the_altitudes_are_worth_at_least_the_lowest_and_within_the_room(kind: str) -> None:
    problem, ground, solution = over_hills(kind, n_users=2)  # three UAVs serve nobody, and are heard by all
    room = room_over(ground, solution.paths_m)
    chosen = chosen_altitudes(problem, ground, room, solution)
    lowest, reached = (
        problem.utility_kbps(served_rates_bps(seen_aloft(problem, ground, solution.paths_m, at), solution) / 1e3)
        for at in (room.floor_m, chosen)
    )
    assert reached >= lowest
    assert (chosen > room.floor_m + 1.0).any()
    assert (chosen >= room.floor_m).all()
    assert (chosen <= room.ceiling_m + 1e-5).all()
    assert (np.abs(np.diff(chosen, axis=1)) <= ground.climb_m[:, None] + 1e-9).all()


def test_a_trial_looks_at_one_uav_and_its_links_whatever_the_fleet(monkeypatch: pytest.MonkeyPatch) -> None:
    problem, ground, solution = over_hills("sum")
    looked_at: list[tuple[int, int]] = []
    of = Heard.of

    def counted(self: Heard, u: int, altitude_m: np.ndarray) -> np.ndarray:
        looked_at.append((u, altitude_m.size * len(self.users) // problem.n_slots))
        return of(self, u, altitude_m)

    monkeypatch.setattr(Heard, "of", counted)
    chosen_altitudes(problem, ground, room_over(ground, solution.paths_m), solution)
    n_links = int((solution.bandwidth_hz > 0.0).sum())
    assert n_links < solution.bandwidth_hz.size / 2  # under `sum` each UAV serves one user at a time
    of_each = len(choosing.SHARES) + 2 + 1  # what is tried, before and after, and the beginning
    assert sum(size for _, size in looked_at) <= of_each * problem.n_uavs * n_links


def test_the_gains_seen_at_altitudes_give_the_squared_distances_of_every_link() -> None:
    problem, ground, solution = over_hills("per_user")
    assert solution.altitudes_m is not None
    paths_m, altitudes_m = solution.paths_m, solution.altitudes_m
    level2 = squared_distances(paths_m, problem.user_m, problem.altitude_m, problem.spread_m2)
    over2 = (altitudes_m[:, None] - ground.user_ground_m) ** 2 - problem.altitude_m[:, None, None] ** 2
    seen = seen_aloft(problem, ground, paths_m, altitudes_m)
    assert seen.snr_gain / level2 == pytest.approx(problem.snr_gain / (level2 + over2), rel=1e-12)
