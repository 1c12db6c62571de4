"""How often a planner process shows its best plan so far, in virtual time."""

from collections.abc import Callable

import pytest

from skyfolio.api.plans.solving import BestSoFar
from skyfolio.planner import EXAMPLES, Plan, plan

MADE = plan(EXAMPLES["minimal"](), n_starts=1)


class Bench:
    """A clock that moves when it is told to, and when a plan is made."""

    def __init__(self, making_s: float) -> None:
        self.now, self.made, self.shown = 0.0, 0, list[float]()
        self._making_s = making_s
        self.best = BestSoFar(lambda _: self.shown.append(round(self.now, 3)), lambda: self.now)

    def make(self) -> Plan:
        self.made += 1
        self.now += self._making_s
        return MADE

    def solve(self, seconds: float, *, offer: Callable[[float], bool]) -> None:
        """Passes of 10 ms; `offer` says which ones find a better plan."""
        until = self.now + seconds
        while self.now < until:
            self.now += 0.01
            if offer(self.now):
                self.best.offer(self.make)
            self.best.show_if_due()


def test_a_solve_that_is_over_at_once_shows_nothing() -> None:
    bench = Bench(making_s=0.001)
    bench.solve(0.2, offer=lambda _: True)
    assert bench.made == 0


def test_the_best_so_far_is_shown_four_times_a_second_while_it_gets_better() -> None:
    bench = Bench(making_s=0.001)
    bench.solve(2.0, offer=lambda _: True)
    assert 6 <= len(bench.shown) <= 8
    assert bench.shown[0] == pytest.approx(0.25, abs=0.02)


def test_a_better_plan_between_two_showings_is_shown_later_and_only_once() -> None:
    bench = Bench(making_s=0.001)
    bench.solve(3.0, offer=lambda now: now < 0.4)
    assert len(bench.shown) == 2
    assert bench.shown[1] == pytest.approx(0.5, abs=0.03)


def test_plans_that_take_long_to_make_are_shown_in_a_twentieth_of_the_time() -> None:
    bench = Bench(making_s=0.5)
    bench.solve(60.0, offer=lambda _: True)
    assert bench.made * 0.5 / bench.now <= 0.06
    assert bench.made >= 5
