"""The pace of sped-up flights, in virtual time: it waits for whoever is late, as long as that takes."""

import asyncio

import pytest

from skyfolio.api.common.fleet_clock import FleetClock
from tests.pacing import AHEAD_S, Pace, paced


class Wall:
    """Wall seconds that a test moves."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def wall() -> Wall:
    return Wall()


@pytest.fixture
def made(wall: Wall) -> Pace:
    return Pace(8.0, source=wall)


def test_alone_it_passes_as_on_the_wall(wall: Wall, made: Pace) -> None:
    wall.now_s += 3.0
    assert made() == 103.0


def test_while_everybody_takes_turns_it_passes_as_on_the_wall(wall: Wall, made: Pace) -> None:
    with made.participant() as one, made.participant() as other:
        for _ in range(300):
            wall.now_s += 0.01
            one()
            other()
        assert made() == pytest.approx(103.0)
        assert made.waited_s == 0.0


def test_a_participant_that_is_late_costs_the_fleet_what_it_would_cost_a_real_one(wall: Wall, made: Pace) -> None:
    fleet = made.fleet_clock()
    with made.participant() as late, made.participant() as other:
        for _ in range(200):
            wall.now_s += 0.01
            other()
        assert fleet.now() == pytest.approx(2.0, abs=1.1 * AHEAD_S)
        late()
        before_s = fleet.now()
        wall.now_s += 0.01
        assert fleet.now() == pytest.approx(before_s + 0.08)
    wall.now_s += 1.0  # nobody takes part any more
    assert fleet.now() == pytest.approx(before_s + 8.08)


def test_a_real_fleet_is_not_waited_for(wall: Wall) -> None:
    made = Pace(1.0, source=wall)
    with made.participant():
        wall.now_s += 30.0
        assert made() == 130.0


def test_utc_passes_with_it(wall: Wall, made: Pace) -> None:
    clock = made.clock()
    slot0_at = clock.utc_of(0.0)
    with made.participant():
        wall.now_s += 2.0
        assert clock.since_utc(slot0_at) == pytest.approx(clock.now())
        assert clock.now() < 3.0


async def test_timers_of_a_paced_loop_follow_it() -> None:
    loop = asyncio.get_running_loop()
    with paced(8.0) as made:
        before_s, loops_s, after_s = made(), loop.time(), made()
        assert before_s <= loops_s <= after_s
        began_s = made()
        await asyncio.sleep(0.1)
        assert made() - began_s >= 0.1
    assert loop.time.__func__ is asyncio.BaseEventLoop.time  # type: ignore[attr-defined]


async def test_a_fleet_clock_sleeps_as_long_as_its_own_seconds_take() -> None:
    seconds = iter([0.0, 0.0, 0.0, 0.02, 0.04, 0.06, 1.0])
    clock = FleetClock(10.0, seconds=lambda: next(seconds))
    await clock.sleep(0.5)
    assert next(seconds) == 1.0
