"""Parts: addressed by what was asked, written whole or not at all, and only those of one sweep are read."""

import os
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import skyfolio.sweep
from skyfolio.api.common import planner_identity
from skyfolio.api.common.planner_identity import OtherPlannerError
from skyfolio.api.lab.sweep import parts
from skyfolio.api.lab.sweep.parts import Parts, SweepError, batches_of, compute
from skyfolio.api.lab.sweep.results import pictures, summary_of
from skyfolio.api.lab.sweep.spec import Spec, spec_of

STUDY: dict[str, Any] = {
    "batch": 2,
    "base": {"example": "minimal"},
    "set": {"starts": 1},
    "vary": {"method": ["static", "baseline1"], "utility.mu_per_kbps": [-0.1, 0.0], "seed": [1, 2]},
}


def addresses(tree: dict[str, Any]) -> list[str]:
    return [batch.address for batch in batches_of(spec_of(tree))]


def computed(spec: Spec, folder: Path) -> Parts:
    """All parts of a sweep, computed here."""
    made = Parts(folder)
    with made.held():
        batches = batches_of(spec)
        made.describe(spec, batches)
        for batch in batches:
            made.write(batch.address, compute(batch))
    return made


def test_a_part_is_named_by_everything_that_was_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    first = addresses(STUDY)
    assert len(set(first)) == 4
    assert addresses(STUDY) == first
    assert not set(addresses({**STUDY, "set": {"starts": 2}})) & set(first)
    assert not set(addresses({**STUDY, "base": {"example": "paper"}})) & set(first)
    monkeypatch.setattr(parts, "rows_identity", lambda: "another")
    assert not set(addresses(STUDY)) & set(first), "another planner may answer otherwise"


def test_values_appended_to_the_first_axis_leave_the_parts_before_as_they_are() -> None:
    more = {**STUDY, "vary": {**STUDY["vary"], "method": ["static", "baseline1", "baseline2"]}}
    assert addresses(more)[:4] == addresses(STUDY)


def test_the_identity_of_the_planner_is_of_all_its_sources(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = planner_identity.planner_identity()
    shutil.copytree(planner_identity.planner_home(), tmp_path / "planner", ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setattr(planner_identity, "planner_home", lambda: tmp_path / "planner")
    found = []
    for _ in range(2):
        planner_identity.planner_identity.cache_clear()
        found.append(planner_identity.planner_identity())
        (tmp_path / "planner" / "explanation" / "users.py").write_text("")
    planner_identity.planner_identity.cache_clear()
    assert found[0] == real
    assert found[1] != real


def test_a_worker_with_another_planner_refuses() -> None:
    batch = replace(batches_of(spec_of(STUDY))[0], planner="0.0.0-other")
    with pytest.raises(OtherPlannerError, match=r"0\.0\.0-other is asked for"):
        compute(batch)


def test_rows_are_read_again_as_they_were_computed(tmp_path: Path) -> None:
    computed(spec_of(STUDY), tmp_path)
    rows = skyfolio.sweep.load(tmp_path)
    assert list(rows["case"]) == list(range(8))
    assert list(rows["method"]) == ["static"] * 4 + ["baseline1"] * 4
    assert list(rows["utility.mu_per_kbps"]) == [-0.1, -0.1, 0.0, 0.0] * 2
    assert (rows["status"] == "succeeded").all()
    assert (rows["utility_bps"] > 0).all()
    table = skyfolio.sweep.load(tmp_path, kind="arrow")
    assert table.num_rows == 8
    assert table.column_names == list(rows.columns)


def test_parts_of_another_sweep_in_the_same_folder_are_left_out(tmp_path: Path) -> None:
    computed(spec_of(STUDY), tmp_path)
    computed(spec_of({**STUDY, "vary": {"method": ["static"]}}), tmp_path)
    assert len(skyfolio.sweep.load(tmp_path)) == 1
    assert len(Parts(tmp_path).there()) == 5


def test_a_part_that_was_not_written_whole_is_not_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    batch = batches_of(spec_of(STUDY))[0]
    made = Parts(tmp_path)

    def out_of_power(_: int) -> None:
        raise OSError("out of power")

    with made.held():
        monkeypatch.setattr(os, "fsync", out_of_power)
        with pytest.raises(OSError, match="out of power"):
            made.write(batch.address, b"half")
        assert made.there() == set()
        assert len(list((tmp_path / "parts").iterdir())) == 1
        monkeypatch.undo()
    with made.held():
        assert list((tmp_path / "parts").iterdir()) == [], "what is left over is removed"


def test_results_can_be_read_by_whom_the_user_lets_read_new_files(tmp_path: Path) -> None:
    made = computed(spec_of({**STUDY, "vary": {"method": ["static"]}}), tmp_path)
    (tmp_path / "plain").touch()
    expected = (tmp_path / "plain").stat().st_mode
    for file in (tmp_path / "sweep.json", *(made.path(address) for address in made.there())):
        assert file.stat().st_mode == expected


def test_two_processes_do_not_compute_into_one_folder(tmp_path: Path) -> None:
    with (
        Parts(tmp_path).held(),
        pytest.raises(SweepError, match="another process computes a sweep"),
        Parts(tmp_path).held(),
    ):
        pass
    with Parts(tmp_path).held():
        pass


def test_reading_what_is_not_there_says_so(tmp_path: Path) -> None:
    with pytest.raises(SweepError, match="no sweep is there"):
        skyfolio.sweep.load(tmp_path)
    made = Parts(tmp_path)
    with made.held():
        made.describe(spec_of(STUDY), batches_of(spec_of(STUDY)))
    with pytest.raises(SweepError, match="no part of the sweep is computed yet"):
        skyfolio.sweep.load(tmp_path)
    made.write(batches_of(spec_of(STUDY))[0].address, b"rubbish")
    with pytest.raises(SweepError, match="a part cannot be read"):
        skyfolio.sweep.load(tmp_path)


def test_the_summary_has_a_row_for_each_group_and_averages_over_seeds(tmp_path: Path) -> None:
    computed(spec_of(STUDY), tmp_path)
    rows, table = skyfolio.sweep.load(tmp_path), summary_of(tmp_path)
    assert list(table.columns[:4]) == ["method", "utility.mu_per_kbps", "cases", "planned"]
    assert len(table) == 4
    assert (table["cases"] == 2).all()
    group = rows[(rows["method"] == "static") & (rows["utility.mu_per_kbps"] == 0.0)]
    summed = table[(table["method"] == "static") & (table["utility.mu_per_kbps"] == 0.0)]
    assert summed["utility_bps_mean"].item() == pytest.approx(group["utility_bps"].mean())


def test_cases_without_a_plan_are_counted_and_not_averaged(tmp_path: Path) -> None:
    spec = spec_of({**STUDY, "vary": {"failed": [[], ["uav-1"], ["uav-1", "uav-2"]]}})
    computed(spec, tmp_path)
    table = summary_of(tmp_path).set_index("failed")
    assert table["planned"].to_dict() == {"[]": 1, '["uav-1"]': 1, '["uav-1", "uav-2"]': 0}
    assert table["utility_bps_mean"].isna().to_dict() == {"[]": False, '["uav-1"]': False, '["uav-1", "uav-2"]': True}


def test_plots_have_a_curve_for_each_group_along_the_first_number(tmp_path: Path) -> None:
    computed(spec_of(STUDY), tmp_path)
    drawn = dict(pictures(tmp_path))
    assert set(drawn) == {"utility", "mean-sum-rate", "sum-rate-variance", "jain", "least-user-rate"}
    (axes,) = drawn["utility"].axes
    assert axes.get_xlabel() == "utility.mu_per_kbps"
    assert (legend := axes.get_legend()) is not None
    assert {text.get_text() for text in legend.get_texts()} == {"method baseline1", "method static"}
    assert [np.asarray(line.get_xdata()).tolist() for line in axes.lines] == [[-0.1, 0.0]] * 2


def test_a_random_design_is_drawn_as_points(tmp_path: Path) -> None:
    vary = {"altitude_m": {"between": [20.0, 80.0]}, "method": ["static", "baseline1"]}
    computed(spec_of({**STUDY, "design": "random", "draws": 80, "batch": 40, "vary": vary}), tmp_path)
    (axes,) = dict(pictures(tmp_path))["utility"].axes
    assert sum(np.size(line.get_xdata()) for line in axes.lines) == 80
    assert list(summary_of(tmp_path).columns[:2]) == ["method", "cases"]
