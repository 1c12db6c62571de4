"""Planted bugs: each fits the sources as they are, and drills find them."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from skyfolio.api.cli.main import cli
from skyfolio.api.lab.torture import mutations
from skyfolio.api.lab.torture.aims import AIMS, aim_of
from skyfolio.api.lab.torture.mutations import Hunt, Mutation, copy_with, hunt_all, read_mutations, source_of

FOLDER = Path(__file__).parent / "mutations"
PLANTED = read_mutations(FOLDER)
EASY = ("never-in-force", "operations-are-not-forgotten")
"""Bugs that the first drills find."""


def test_at_least_fifty_bugs_are_planted() -> None:
    assert len(PLANTED) >= 50


@pytest.mark.parametrize("mutation", PLANTED, ids=lambda mutation: mutation.name)
def test_a_planted_bug_fits_the_source(mutation: Mutation) -> None:
    source = source_of(mutation)
    assert mutation.applied(source) != source


def mutation(**changes: Any) -> Mutation:
    given: dict[str, Any] = {"name": "one", "file": "api/store/errors.py", "why": "because"}
    given |= {"before": "class", "after": "class"}
    return Mutation(**{**given, **changes})


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"before": "no such text"}, "is 0 times in"),
        ({"before": "e"}, "times in api/store/errors.py, not once"),
        ({"after": "class class"}, "does not compile"),
    ],
)
def test_a_bug_that_does_not_fit_is_refused(changed: dict[str, str], message: str) -> None:
    planted = mutation(**changed)
    with pytest.raises(ValueError, match=message):
        planted.applied(source_of(planted))


def test_drills_that_are_after_a_bug_are_flown_first_and_the_one_that_found_it_before_them() -> None:
    aim = next(iter(AIMS))
    aimed = [seed for seed in range(1, 101) if aim_of(seed) == aim]
    order = sorted(range(1, 101), key=mutation(aims=[aim], found_by=7).rank)
    assert order[: len(aimed) + 1] == [7, *aimed]
    assert sorted(order) == list(range(1, 101))


def test_an_aim_that_no_drill_has_is_refused() -> None:
    with pytest.raises(ValueError, match="aims: nothing of mutation 'one' is not one of two_losses"):
        mutation(aims=["nothing"])


def test_only_what_is_copied_is_changed() -> None:
    with pytest.raises(ValueError, match="is not in api or mavlink_bridge"):
        source_of(mutation(file="planner/plans.py"))


def test_a_copy_has_the_bug_and_the_package_has_not() -> None:
    planted = mutation(after="# a bug\nclass")
    before = source_of(planted)
    with copy_with(planted) as folder:
        assert (folder / "skyfolio" / planted.file).read_text() == planted.applied(before)
    assert source_of(planted) == before
    assert not folder.exists()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[[mutation]]\nname = 'one'\n", "missing 4 required"),
        ("[[mutation]]\nname = 'one'\nfile = ''\nwhy = ''\nbefore = ''\nafter = ''\n" * 2, "given twice"),
    ],
)
def test_a_file_that_makes_no_sense_is_refused(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "some.toml").write_text(text)
    with pytest.raises(ValueError, match=message):
        read_mutations(tmp_path)
    refused = CliRunner().invoke(cli, ["torture", "--mutations", str(tmp_path)])
    assert refused.exit_code != 0


def found_at_once(folder: Path | None, seeds: Sequence[int]) -> tuple[int, dict[str, str]] | None:
    """As if the first drill broke something, with a bug in it."""
    return None if folder is None else (seeds[0], {"all": "at once"})


@pytest.mark.e2e
def test_drills_find_a_planted_bug_and_a_hunt_goes_on_where_it_was_stopped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    easy = [planted for planted in PLANTED if planted.name in EASY]
    results = tmp_path / "mutations.json"
    first = hunt_all(easy[:1], results, seeds=range(1, 11), told=lambda _hunt: None)
    hunted: list[Hunt] = []
    monkeypatch.setattr(mutations, "_first_failure", found_at_once)
    both = hunt_all(easy, results, seeds=range(1, 11), jobs=2, told=hunted.append)
    assert both[0] == first[0]
    assert both[0].broken != both[1].broken == {"all": "at once"}
    assert [hunt.found for hunt in both] == [True, True]
    assert {hunt.name for hunt in hunted} == {planted.name for planted in easy}
    assert {row["name"] for row in json.loads(results.read_text())["mutations"]} == set(EASY)
