"""The benchmark: its yardstick solves the same problem, its figures are consistent, its report says them."""

import asyncio
import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skyfolio.api.cli import bench
from skyfolio.api.cli import main as cli
from skyfolio.api.lab.bench import loop, markdown, planner_figures, radio, table
from skyfolio.api.lab.bench.best_known import improve, instances, load, note_search, searched
from skyfolio.api.lab.bench.cases import CASES, SIZES, instance, stop
from skyfolio.api.lab.bench.checked import broken
from skyfolio.api.lab.bench.ipopt import Trajectories, alternate, utility_of
from skyfolio.api.lab.bench.peers import peers, value_kbps
from skyfolio.api.lab.bench.planner import in_a_process
from skyfolio.api.plans.certificate import certify, shown
from skyfolio.planner import EXAMPLES, Scenario, letter, plan
from skyfolio.planner.fast import linked, optimise
from skyfolio.planner.problem import problem_of

TINY = ((2, 4, 5), (3, 5, 6))


def in_this_process(case: str, size: tuple[int, int, int], kind: str) -> dict[str, Any]:
    """No yardstick for the larger size, as if it had taken too long."""
    if case == "ipopt" and size == TINY[1]:
        return {"skipped": "not done after 150 s"}
    return CASES[case](size, kind, quick=True)


@pytest.fixture(scope="module")
def figures() -> dict[str, Any]:
    return planner_figures(quick=False, run=in_this_process, sizes=TINY)


@pytest.mark.parametrize("kind", ["sum", "per_user"])
def test_ipopt_gets_the_problem_that_the_planner_has(kind: str) -> None:
    problem = problem_of(instance(TINY[0], kind))
    links = TINY[0][0] if kind == "sum" else TINY[0][1]
    hover = linked(problem, problem.hover())
    started = utility_of(problem, hover.paths_m, hover.serving, hover.bandwidth_hz)
    assert started == pytest.approx(value_kbps(problem, hover), rel=1e-12)
    moved = Trajectories(problem, links).solve(hover.paths_m, hover.serving, hover.bandwidth_hz)
    assert utility_of(problem, moved, hover.serving, hover.bandwidth_hz) > started * 1.02
    assert np.linalg.norm(np.diff(moved, axis=1), axis=2).max() <= 25.0 + 1e-4
    assert (moved[:, 0] == problem.start_m).all()


def test_ipopt_and_the_fast_path_agree_from_the_same_start() -> None:
    problem = problem_of(instance(TINY[0], "sum"))

    def shares(paths: Any) -> tuple[Any, Any]:
        found = linked(problem, paths)
        return found.serving, found.bandwidth_hz

    theirs = alternate(problem, shares, problem.hover(), TINY[0][0])
    ours = value_kbps(problem, optimise(problem, stop(), n_starts=1))
    assert ours == pytest.approx(theirs["utility_kbps"], rel=2e-3)
    assert theirs["solve_s"] > 0


def test_rows_hold_times_objectives_bounds_and_ratios(figures: dict[str, Any]) -> None:
    assert [(row["size"], row["kind"]) for row in figures["rows"]] == [
        ("2x4x5", "sum"), ("2x4x5", "per_user"), ("3x5x6", "sum"), ("3x5x6", "per_user"),
    ]  # fmt: skip
    row = figures["rows"][0]
    assert 0 < row["fast"]["plan"]["best_ms"] <= row["fast"]["plan"]["p50_ms"] <= row["fast"]["plan"]["p99_ms"]
    assert row["fast"]["bound_kbps"] >= row["fast"]["plan"]["utility_kbps"]
    assert row["fast"]["plan_starts"]["utility_kbps"] >= row["fast"]["plan"]["utility_kbps"]
    ratio = row["reference"]["plan"]["cpu_p50_ms"] / row["fast"]["plan"]["cpu_p50_ms"]
    assert row["ratios"]["reference_plan_time"] == pytest.approx(ratio)
    assert row["ratios"]["ipopt_plan_utility"] == pytest.approx(0.0, abs=2e-3)
    assert "ipopt_plan_time" not in figures["rows"][2]["ratios"]
    assert figures["machine"]["cores"] >= 1
    json.dumps(figures)


def test_every_part_is_measured_and_every_target_judged(figures: dict[str, Any]) -> None:
    parts = figures["ablation"]["sum"]["rows"]
    assert [part["what"].split(":")[0] for part in parts] == [
        "paper alternation", "joint step", "single start", "multi-start",
    ]  # fmt: skip
    assert parts[3]["utility_kbps"] >= parts[2]["utility_kbps"]
    proof = figures["proof"]["sum"]
    assert 0 <= proof["gap_mean"] <= proof["root_gap_mean"]
    for target in figures["targets"]:
        limit = target.get("at_most", target.get("at_least"))
        assert target["met"] == (target["measured"] <= limit if "at_most" in target else target["measured"] >= limit)


def test_the_report_holds_the_figures_and_nothing_else(figures: dict[str, Any], tmp_path: Path) -> None:
    text = markdown(figures)
    assert figures["machine"]["cpu"] in text
    for row in figures["rows"]:
        assert f"{row['fast']['plan']['utility_kbps']:.2f}" in text
    assert "| 3x5x6 | sum |" in text
    assert table(figures).row_count == 4
    file, out = tmp_path / "figures.json", tmp_path / "report.md"
    file.write_text(json.dumps(figures))
    bench.report(file, out)
    assert out.read_text() == text


def test_a_case_that_failed_is_shown_as_left_out(figures: dict[str, Any]) -> None:
    broken = json.loads(json.dumps(figures))
    broken["rows"][0]["fast"] = {"skipped": "not done after 150 s"}
    broken["ablation"]["sum"] = {"skipped": "failed"}
    assert "not done after 150 s" in markdown(broken)


def test_bound_proves_how_good_a_plan_is(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr("sys.argv", ["skyfolio", "bound", "--example", "minimal", "--tolerance", "0.02", "--json"])
    with pytest.raises(SystemExit):
        cli.main()
    proven = json.loads(capsys.readouterr().out)
    assert proven["utility_bps"] <= proven["upper_bound_bps"] <= proven["root_bound_bps"]
    assert proven["gap"] <= 0.05
    assert proven["finished"]


def test_bound_proves_how_good_the_plan_of_a_fleet_is(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    file = tmp_path / "fleet.json"
    file.write_text(instance((6, 20, 8), "sum").model_dump_json())
    monkeypatch.setattr("sys.argv", ["skyfolio", "bound", str(file), "--seconds", "60", "--json"])
    with pytest.raises(SystemExit):
        cli.main()
    proven = json.loads(capsys.readouterr().out)
    assert proven["utility_bps"] <= proven["upper_bound_bps"] <= proven["root_bound_bps"]
    assert len(proven["slot_upper_bounds_bps"]) == 8
    assert proven["method"] == "crowding"
    assert proven["looked_at"] > 0
    assert proven["upper_bound_bps"] < proven["root_bound_bps"]


def test_bound_tells_what_is_proven_by_now_and_its_sentences_say_how() -> None:
    told: list[tuple[float, float]] = []
    figures = certify(
        instance((4, 9, 4), "sum"), tolerance=0.01, seconds=0.5, told=lambda *progress: told.append(progress)
    )
    seconds, bounds = zip(*told, strict=True)
    assert list(seconds) == sorted(seconds)
    assert list(bounds) == sorted(bounds, reverse=True)
    assert bounds[-1] >= figures["upper_bound_bps"] * (1 - 1e-9)
    assert "assignments in" in shown(figures)
    assert "at most" in shown(figures)


async def test_the_loop_is_measured_for_everything_that_a_flight_asks_of_it() -> None:
    figures = await loop.loop_figures((2, 4, 5), runs=1)
    assert figures["size"] == "2x4x5"
    kinds = {name: row for name, row in figures.items() if isinstance(row, dict)}
    assert len(kinds) == 10
    assert all(row["at_once_ms"] > 0 and row["held_ms"] > 0 for row in kinds.values())
    assert set(figures["over_20_ms"]) <= set(kinds)


async def test_a_hold_is_as_long_as_the_longest_piece_and_not_as_all_of_them(monkeypatch: pytest.MonkeyPatch) -> None:
    now_s = 0.0

    async def pieces(*seconds: float) -> None:
        nonlocal now_s
        for one in seconds:
            now_s += one
            await asyncio.sleep(0)

    monkeypatch.setattr(loop, "time", SimpleNamespace(perf_counter=lambda: now_s))
    assert await loop.longest_hold_ms(lambda: pieces(0.002, 0.003, 0.002)) == pytest.approx(3.0)
    assert await loop.longest_hold_ms(lambda: pieces(0.007)) == pytest.approx(7.0)


@pytest.mark.e2e
@pytest.mark.parametrize("case", CASES)
def test_a_case_runs_in_a_process_of_its_own(case: str) -> None:
    found = in_a_process(case, TINY[0], "sum", quick=True)
    assert "skipped" not in found
    assert ("plan" in found) == (case in {"fast", "reference", "ipopt"})


def test_quality_is_a_share_of_the_best_known_and_stands_in_the_report(figures: dict[str, Any]) -> None:
    case = figures["quality"]["3x5x6"]
    assert set(case) == {"sum", "per_user", "pooled"}
    for kind in case.values():
        assert 0.9 < kind["share"] <= 1.0
        assert 0.9 < kind["replan_share"] <= 1.0
        assert kind["plan_cpu_ms"] > 0
    text = markdown(figures)
    assert "## Quality" in text
    assert "| 3x5x6 | pooled | 1 | 100.00% |" in text


def test_best_known_values_are_improved_when_beaten_and_never_lowered(tmp_path: Path) -> None:
    file, one = tmp_path / "best.json", instances(TINY[0])[0]
    assert improve(one, 10.0, "first", 1.0, file)
    assert not improve(one, 9.0, "worse", 1.0, file)
    assert not improve(one, 10.0, "the same", 1.0, file)
    assert improve(one, 11.0, "better", 2.0, file)
    assert load(file) == {one.name: {"utility_kbps": 11.0, "found_by": "better", "seconds": 2.0}}


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 100_000))
def test_random_plans_and_replans_pass_the_independent_check(seed: int) -> None:
    assert broken(seed) == []


def test_a_search_for_best_known_values_that_was_interrupted_goes_on_where_it_was(tmp_path: Path) -> None:
    file, (first, second, *_) = tmp_path / "best.json", instances(TINY[0])
    improve(first, 10.0, "found", 1.0, file)
    assert not searched(first, 600.0, 1, file)
    note_search(first, 600.0, 1, file)
    assert searched(first, 600.0, 1, file)
    assert searched(first, 60.0, 1, file)
    assert not searched(first, 601.0, 1, file)
    assert not searched(first, 600.0, 2, file)
    assert not searched(second, 600.0, 1, file)
    assert improve(first, 11.0, "better", 2.0, file)
    assert searched(first, 600.0, 1, file)
    assert load(file)[first.name]["utility_kbps"] == 11.0
    assert [one.name for one in tmp_path.iterdir()] == ["best.json"]


def test_best_known_values_belong_to_instances_there_are() -> None:
    names = {one.name for size in SIZES[1:] for one in instances(size)}
    table = load()
    assert set(table) <= names
    assert {one.name for one in instances(SIZES[1])} <= set(table)
    assert all(entry["utility_kbps"] > 0 and entry["found_by"] for entry in table.values())


@pytest.mark.parametrize("kind", ["sum", "per_user", "pooled"])
def test_a_default_plan_of_ten_uavs_comes_near_the_best_known(kind: str) -> None:
    one = next(one for one in instances(SIZES[1]) if one.kind == kind)
    problem = problem_of(one.scenario())
    assert value_kbps(problem, optimise(problem, stop())) >= 0.985 * load()[one.name]["utility_kbps"]


def test_peers_solve_the_same_problem() -> None:
    problem = problem_of(instances((5, 12, 6))[0].scenario())
    best = value_kbps(problem, optimise(problem, stop()))
    for name, found in peers(problem, 0.3, with_ipopt=True).items():
        assert 0.3 * best < found["utility_kbps"] < 1.05 * best, name


def test_the_bench_of_expected_rates_judges_both_plans_in_the_same_unseen_air() -> None:
    scenario = EXAMPLES["paper"]().with_changes(slots=3)
    on_mean = plan(scenario, n_starts=1)
    two = [radio.achieved_kbps(on_mean, [seed]) for seed in (5, 6)]
    assert radio.achieved_kbps(on_mean, [5, 6]) == pytest.approx(np.mean(two, axis=0))
    assert not np.isclose(two[0], two[1]).all()
    told = on_mean.model_copy(update={"scenario": expecting(scenario)})
    assert radio.achieved_kbps(told, [5]) == pytest.approx(two[0]), "what was planned for does not change the air"


def test_the_bench_of_expected_rates_says_gain_and_price_of_each_number_of_draws(monkeypatch: Any) -> None:
    monkeypatch.setattr(radio, "DRAWS", (2,))
    monkeypatch.setattr(radio, "UTILITIES", radio.UTILITIES[:1])
    monkeypatch.setattr(radio, "letter", lambda layout_seed: letter(layout_seed=layout_seed).with_changes(slots=3))
    figures = radio.radio_figures(2, 4, large=False)
    assert [row["draws"] for row in figures["rows"]] == [0, 2]
    assert figures["rows"][0]["rate_gain_percent"] == [0.0, 0.0]
    assert all(row["cpu_ms"] > 0 and row["promised_kbps"] > 0 for row in figures["rows"])
    assert radio.table(figures).row_count == 2


def expecting(scenario: Scenario) -> Scenario:
    return scenario.with_changes(channel=scenario.channel.model_copy(update={"fading": "expected"}))
