"""Stopping rules and how they combine."""

import pytest

from skyfolio.planner import AnyOf, Deadline, Iteration, MaxIterations, RelativeGain, StopToken


def history(*utilities: float) -> list[Iteration]:
    return [Iteration(iteration=i + 1, utility_bps=u, mean_sum_rate_bps=u) for i, u in enumerate(utilities)]


def test_relative_gain_waits_for_two_iterations_and_a_small_step() -> None:
    rule = RelativeGain(0.01)
    assert not rule(history(100.0))
    assert not rule(history(100.0, 102.0))
    assert rule(history(100.0, 102.0, 103.0))


def test_max_iterations_stops_at_its_limit() -> None:
    assert not MaxIterations(2)(history(1.0))
    assert MaxIterations(2)(history(1.0, 2.0))


def test_a_deadline_follows_the_given_clock() -> None:
    now = [10.0]
    rule = Deadline(0.5, clock=lambda: now[0])
    assert not rule([])
    now[0] = 10.5
    assert rule([])
    assert rule.interrupts


def test_any_of_says_whether_an_interrupting_rule_stopped_it() -> None:
    asked = [False]
    rule = AnyOf(MaxIterations(2), StopToken(lambda: asked[0]))
    assert not rule(history(1.0))
    assert rule(history(1.0, 2.0))
    assert not rule.interrupts
    asked[0] = True
    assert rule(history(1.0))
    assert rule.interrupts


@pytest.mark.parametrize(
    ("build", "said"),
    [
        (lambda: MaxIterations(0), "limit 0 must be at least 1"),
        (lambda: RelativeGain(-1.0), "tolerance -1.0 must be at least 0"),
        (lambda: Deadline(0.0, clock=lambda: 0.0), "seconds 0.0 must be above 0"),
    ],
)
def test_a_rule_that_makes_no_sense_is_refused(build: object, said: str) -> None:
    assert callable(build)
    with pytest.raises(ValueError, match=said):
        build()
