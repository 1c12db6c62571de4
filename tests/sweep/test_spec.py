"""What a sweep's file asks for."""

from pathlib import Path
from typing import Any

import pytest

from skyfolio.api.lab.sweep.settings import check
from skyfolio.api.lab.sweep.spec import SpecError, read_spec, spec_of

PAPER: dict[str, Any] = {"example": "paper"}
LETTER: dict[str, Any] = {"layout": {"kind": "letter"}}


def test_a_grid_holds_every_combination_with_the_first_axis_slowest() -> None:
    spec = spec_of({"base": PAPER, "vary": {"method": ["fast", "baseline1"], "utility": {"mu_per_kbps": [0, -0.5]}}})
    assert spec.cases() == [
        {"method": "fast", "utility.mu_per_kbps": 0.0},
        {"method": "fast", "utility.mu_per_kbps": -0.5},
        {"method": "baseline1", "utility.mu_per_kbps": 0.0},
        {"method": "baseline1", "utility.mu_per_kbps": -0.5},
    ]
    assert spec.n_cases == 4


def test_values_of_an_axis_are_all_floats_where_one_is() -> None:
    spec = spec_of({"base": PAPER, "vary": {"altitude_m": [60, 80.5]}})
    assert {type(case["altitude_m"]) for case in spec.cases()} == {float}


def test_ranges_are_whole_and_intervals_are_divided_evenly_or_by_equal_ratios() -> None:
    spec = spec_of(
        {
            "base": PAPER,
            "vary": {
                "seed": {"range": [3, 5]},
                "altitude_m": {"between": [40.0, 60.0], "steps": 3},
                "utility.mu_per_kbps": {"between": [-10.0, -0.1], "steps": 3, "scale": "log"},
            },
        }
    )
    assert list(spec.vary["seed"].grid()) == [3, 4, 5]
    assert list(spec.vary["altitude_m"].grid()) == [40.0, 50.0, 60.0]
    assert list(spec.vary["utility.mu_per_kbps"].grid()) == pytest.approx([-10.0, -1.0, -0.1])


def test_a_random_design_draws_the_same_for_a_seed_and_keeps_its_cases_when_it_grows() -> None:
    vary = {"layout.seed": {"range": [0, 99]}, "altitude_m": {"between": [40.0, 90.0]}, "method": ["fast", "static"]}
    tree = {"design": "random", "draws": 20, "seed": 4, "base": LETTER, "vary": vary}
    drawn = spec_of(tree).cases()
    assert spec_of(tree).cases() == drawn
    assert spec_of({**tree, "draws": 50}).cases()[:20] == drawn
    assert spec_of({**tree, "seed": 5}).cases() != drawn
    assert all(0 <= case["layout.seed"] <= 99 and 40 <= case["altitude_m"] <= 90 for case in drawn)
    assert {case["method"] for case in drawn} == {"fast", "static"}


def test_a_range_of_billions_may_be_drawn_from() -> None:
    spec = spec_of({"design": "random", "draws": 2, "base": LETTER, "vary": {"layout.seed": {"range": [0, 2**31 - 1]}}})
    check(spec)
    assert len(spec.cases()) == 2


def test_seeds_are_averaged_over_unless_the_file_says_otherwise() -> None:
    tree = {"base": LETTER, "vary": {"layout.seed": [1, 2], "method": ["fast", "static"]}}
    assert spec_of(tree).averaged == ("layout.seed",)
    assert spec_of({**tree, "over": ["method"]}).averaged == ("method",)


def test_a_scenario_file_is_looked_for_beside_the_spec(tmp_path: Path) -> None:
    (tmp_path / "town.json").write_text('{"slots": 3}')
    (tmp_path / "study.toml").write_text('[base]\nscenario = "town.json"\n')
    assert read_spec(tmp_path / "study.toml").base.scenario == {"slots": 3}


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"base": {}}, "give example, scenario or layout"),
        ({"base": {"example": "pap"}}, "example: "),
        ({"base": {"scenario": "nowhere.json"}}, "base.scenario: "),
        ({"design": "random"}, "draws: a random design needs it"),
        ({"draws": 3}, "draws: a random design needs it, and a grid has none"),
        ({"surprise": 1}, "surprise: "),
        ({"batch": 0}, "batch: "),
        ({"vary": {"slots": []}}, "vary.slots: must be a list of values"),
        ({"vary": {"slots": 3}}, "vary.slots: must be a list of values"),
        ({"vary": {"slots": [3, "4"]}}, "vary.slots: must hold values of one type"),
        ({"vary": {"altitude_m": [float("inf")]}}, "altitude_m: "),
        ({"vary": {"altitude_m": {"between": [1.0, 2.0]}}}, "vary.altitude_m: in a grid, `between` needs `steps`"),
        ({"vary": {"altitude_m": {"between": [2.0, 1.0], "steps": 3}}}, "between: "),
        ({"vary": {"mu": {"between": [-1.0, 1.0], "steps": 3, "scale": "log"}}}, "between: a log scale"),
        ({"vary": {"slots": {"range": [5, 4]}}}, "range: "),
        ({"set": {"slots": 3}, "vary": {"slots": [3]}}, "vary.slots: it is set, too"),
        ({"over": ["slots"]}, "over: 'slots' is not varied"),
        ({"vary": {"slots": {"range": [1, 10**9]}}}, "vary"),
    ],
)
def test_a_file_that_makes_no_sense_is_refused_by_field(changed: dict[str, Any], message: str) -> None:
    with pytest.raises(SpecError) as refused:
        spec_of({"base": PAPER, **changed})
    assert message in str(refused.value)


@pytest.mark.parametrize(
    ("vary", "message"),
    [
        ({"chanel.noise_dbm": [-60]}, "chanel.noise_dbm: a scenario has no field 'chanel'"),
        ({"channel.noise": [-60]}, "channel.noise: a scenario has no field 'noise'"),
        ({"slots": [20, 0]}, "slots: "),
        ({"uavs.uav-9.bandwidth_hz": [1e4]}, "uavs.uav-9.bandwidth_hz: 'uav-9' is none of the 3 there"),
        ({"method": ["fast", "quick"]}, "method: 'quick' must be one of fast, areas, paper"),
        ({"failed": ["uav-1"]}, "failed: 'uav-1' must be a list of UAV ids"),
        ({"starts": [0]}, "starts: 0 must be an integer of at least 1"),
        ({"layout.seed": [1]}, "layout.seed: the base has no layout"),
    ],
)
def test_a_value_that_no_case_can_have_is_found_before_anything_is_computed(vary: dict[str, Any], message: str) -> None:
    with pytest.raises(SpecError) as refused:
        check(spec_of({"base": PAPER, "vary": vary}))
    assert message in str(refused.value)
