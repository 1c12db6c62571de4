"""What drills are after: each aim has its turn, and makes a drill that can be flown, always the same."""

from __future__ import annotations

from collections import Counter

import pytest

from skyfolio import sim
from skyfolio.api.flights.journal import Step
from skyfolio.api.lab.torture.aims import AIMS, LATER, NEWEST, NEWEST_FROM, aim_of
from skyfolio.api.lab.torture.blows import BLOWS
from skyfolio.api.lab.torture.drill import Drill
from skyfolio.api.lab.torture.flight import fly
from skyfolio.api.lab.torture.generator import drill_of


def seeds_of(aim: str, most: int) -> list[int]:
    return [seed for seed in range(1, 2001) if aim_of(seed) == aim][:most]


def test_even_drills_have_each_aim_in_its_turn_and_most_odd_ones_are_left_to_chance() -> None:
    first = [aim for aim in AIMS if aim not in (*LATER, *NEWEST)]
    assert Counter(aim_of(seed) for seed in range(0, 4 * len(first), 2)) == dict.fromkeys(first, 2)
    odd = Counter(aim_of(seed) for seed in range(1, 32, 2))
    assert odd.pop(None) == 14
    assert odd == dict.fromkeys(LATER, 2)


def test_the_newest_aims_take_turns_from_a_seed_on_below_which_all_stays_as_it_was() -> None:
    taken = [seed for seed in range(2001) if aim_of(seed) in NEWEST]
    assert taken == [seed for seed in range(NEWEST_FROM, 2001) if seed % 16 == 7]
    assert [aim_of(seed) for seed in taken[:4]] == [*NEWEST, *NEWEST]


def test_a_recovery_leads_along_the_way_home_of_who_was_lost_and_above_it() -> None:
    outcome = fly(drill_of(seeds_of("a_loss_whose_way_home_others_need", 1)[0]))
    assert outcome.broken == {}
    avoided = [event.data for event in outcome.events if event.kind == "ghost_avoided"]
    assert any("the way home of 'uav-1'" in str(data["because"]) for data in avoided)


def test_a_mission_that_ends_before_that_is_told_is_nobodys_doing() -> None:
    outcome = fly(drill_of(seeds_of("an_end_that_is_told_late", 1)[0]))
    assert (outcome.broken, outcome.state) == ({}, "completed")
    assert sum("withhold" in blow for blow in outcome.blows) == 3


@pytest.mark.parametrize("aim", sorted(AIMS))
def test_an_aimed_drill_is_one_that_can_be_replayed(aim: str) -> None:
    for seed in seeds_of(aim, 20):
        drill = drill_of(seed)
        assert drill == drill_of(seed)
        assert Drill.model_validate_json(drill.model_dump_json()) == drill
        for blow in drill.blows:
            assert blow.kind in BLOWS
            if blow.kind == "vehicle":
                assert sim.fault_from(blow.options).system_id in (1, 2, 3)


def test_aimed_drills_differ() -> None:
    assert all(len({drill_of(seed).model_dump_json() for seed in seeds_of(aim, 5)}) == 5 for aim in AIMS)


def test_a_second_loss_comes_while_the_first_is_dealt_with() -> None:
    drills = map(drill_of, seeds_of("a_loss_while_recovering", 20))
    soon = next(one for one in drills if one.blows[1].when.after_s - one.blows[0].when.after_s < 1.0)
    outcome = fly(soon)
    assert outcome.broken == {}
    closed = [step for step in outcome.steps if f"journal 1 {Step.CLOSED.value}" in step]
    assert "superseded by another loss" in closed[0]


def test_an_order_comes_while_a_mission_is_sent() -> None:
    outcome = fly(drill_of(seeds_of("an_order_while_missions_are_sent", 1)[0]))
    assert outcome.broken == {}
    assert any("'cause': 'ordered'" in str(event.data) for event in outcome.events if event.kind == "uav_lost")
