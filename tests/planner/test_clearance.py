"""The independent check of altitudes: it finds what is made wrong on purpose."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from skyfolio.planner import EXAMPLES, MaxIterations, Plan, plan
from skyfolio.planner.clearance import breaches
from tests.planner.hills import over_the_hill


@pytest.fixture(scope="module")
def made() -> Plan:
    return plan(over_the_hill(altitude_min_m=30.0, altitude_max_m=120.0), n_starts=2, stop=MaxIterations(4))


def lowered(plan: Plan, uav: str, slot: int, by_m: float) -> Plan:
    assert plan.altitudes_m is not None
    row = [up - by_m * (n == slot) for n, up in enumerate(plan.altitudes_m[uav])]
    return plan.model_copy(update={"altitudes_m": {**plan.altitudes_m, uav: row}})


def test_a_sound_plan_has_no_breach(made: Plan) -> None:
    assert list(breaches(made)) == []


def test_one_slot_that_is_a_centimetre_too_low_is_found(made: Plan) -> None:
    found = [one for slot in range(made.scenario.slots) for one in breaches(lowered(made, "west", slot, 0.01))]
    assert {one.rule for one in found} >= {"altitude", "clearance"}
    assert all("west slot" in one.where for one in found)


@pytest.mark.parametrize(
    ("change", "rule", "words"),
    [
        (lambda made: lowered(made, "west", 3, 50.0), "climb", "climbs"),
        (lambda made: lowered(made, "south", 2, -300.0), "altitude", "more than 120 m"),
        (lambda made: made.model_copy(update={"altitudes_m": None}), "altitude", "has 0 altitudes of 12"),
        (
            lambda made: made.model_copy(update={"altitudes_m": {**made.altitudes_m, "west": [float("nan")] * 12}}),
            "altitude",
            "has 12 altitudes of 12",
        ),
    ],
)
def test_each_rule_is_checked(made: Plan, change: Callable[[Plan], Plan], rule: str, words: str) -> None:
    found = [one for one in breaches(change(made)) if one.rule == rule]
    assert any(words in one.message for one in found)


def test_a_hill_between_a_leg_and_home_is_found_though_no_leg_is_over_it(made: Plan) -> None:
    around = [(60.0, 250.0), (60.0, 290.0), (60.0, 330.0), (60.0, 370.0), (90.0, 395.0), (125.0, 415.0)]
    around += [(165.0, 430.0), (205.0, 440.0), (245.0, 440.0), (285.0, 430.0), (325.0, 415.0), (365.0, 390.0)]
    low = made.model_copy(
        update={
            "trajectories_m": {**made.trajectories_m, "west": around},
            "altitudes_m": {**(made.altitudes_m or {}), "west": [445.0] * 12},
        }
    )
    found = {one.where for one in breaches(low) if one.rule == "clearance" and "west" in one.where}
    assert found == {f"west slot {n}, on the way home" for n in range(7, 12)}


def test_altitudes_that_nobody_asked_for_are_a_breach() -> None:
    flat = plan(EXAMPLES["paper"](), n_starts=1, stop=MaxIterations(1))
    assert list(breaches(flat)) == []
    [found] = breaches(flat.model_copy(update={"altitudes_m": {uav: [1.0] * 20 for uav in flat.scenario.uav_ids}}))
    assert found.message == "the scenario asks for none"
