"""`skyfolio sweep` from the command line, on parts that are there: no cluster is started for them."""

import json
import re
import sys
import tomllib
from pathlib import Path

import pytest
from rich.console import Console

from skyfolio.api.cli.main import main
from skyfolio.api.lab.sweep.parts import Parts, batches_of, compute
from skyfolio.api.lab.sweep.settings import check
from skyfolio.api.lab.sweep.spec import read_spec, spec_of

ROOT = Path(__file__).resolve().parents[2]
STUDY = """
batch = 2
[base]
example = "minimal"
[set]
starts = 1
[vary]
method = ["static", "baseline1"]
utility.mu_per_kbps = [-0.1, 0.0]
"""


@pytest.fixture
def study(tmp_path: Path) -> Path:
    """The file of a sweep whose parts are all in `out`."""
    file = tmp_path / "study.toml"
    file.write_text(STUDY)
    spec, parts = read_spec(file), Parts(tmp_path / "out")
    with parts.held():
        for batch in batches_of(spec):
            parts.write(batch.address, compute(batch))
    return file


def run(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int:
    monkeypatch.setattr(sys, "argv", ["skyfolio", "sweep", *arguments])
    with pytest.raises(SystemExit) as ended:
        main()
    return int(ended.value.code or 0)


def test_it_says_what_is_there_as_json(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], study: Path
) -> None:
    out = study.parent / "out"
    assert run(monkeypatch, str(study), "--out", str(out), "--json") == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["cases"], told["found"], told["computed"], told["complete"]) == (4, 4, 0, True)
    assert [row["method"] for row in told["summary"]] == ["baseline1", "baseline1", "static", "static"]
    assert {Path(file).name for file in told["files"]} >= {"summary.csv", "utility.svg"}
    assert all(Path(file).stat().st_size > 0 for file in told["files"])


def test_it_prints_the_summary(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], study: Path
) -> None:
    assert run(monkeypatch, str(study), "--out", str(study.parent / "out")) == 0
    captured = capsys.readouterr()
    assert captured.out == ""
    assert "4 of 4 cases: 4 were there, 0 computed" in captured.err


@pytest.mark.parametrize("columns", ["80", "200"])
def test_no_value_of_the_summary_is_cut_off_however_narrow_the_terminal_is(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], study: Path, columns: str
) -> None:
    monkeypatch.setattr("skyfolio.api.cli.sweep.console", Console(stderr=True, width=int(columns)))
    assert run(monkeypatch, str(study), "--out", str(study.parent / "out")) == 0
    shown = capsys.readouterr().err
    assert "…" not in shown
    assert "baseline1" in shown
    assert ("least user" in shown) == (columns == "200")


def test_a_mistake_in_the_file_names_its_field_and_ends_with_status_2(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], study: Path
) -> None:
    study.write_text(STUDY.replace("starts = 1", "altitude_m = -1"))
    assert run(monkeypatch, str(study), "--out", str(study.parent / "out")) == 2
    assert "error: altitude_m: " in capsys.readouterr().err


def test_the_file_in_the_documentation_is_one() -> None:
    (text,) = re.findall(r"^```toml\n(.*?)^```$", (ROOT / "docs/scaling.md").read_text(), re.MULTILINE | re.DOTALL)
    spec = spec_of(tomllib.loads(text))
    check(spec)
    assert spec.n_cases == 5 * 2 * 7 * 3 * 20 * 2
