"""Random scenarios."""

import pytest

from skyfolio.planner.layouts import scattered
from skyfolio.planner.problem import problem_of


@pytest.mark.parametrize(("n_uavs", "n_users"), [(1, 1), (3, 9), (10, 100)])
def test_a_layout_has_the_asked_size_and_is_valid(n_uavs: int, n_users: int) -> None:
    problem = problem_of(scattered(n_uavs, n_users, 5, seed=1))
    assert (problem.n_uavs, problem.n_users, problem.n_slots) == (n_uavs, n_users, 5)


def test_the_same_seed_gives_the_same_layout_and_another_seed_another() -> None:
    assert scattered(3, 9, 20, seed=1) == scattered(3, 9, 20, seed=1)
    assert scattered(3, 9, 20, seed=1) != scattered(3, 9, 20, seed=2)
