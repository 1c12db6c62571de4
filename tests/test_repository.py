"""The repository says the truth about itself."""

import re
import tomllib
from importlib.metadata import version
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def test_the_version_is_the_newest_heading_of_the_changelog() -> None:
    headings = re.findall(r"^## (\S+)", (ROOT / "CHANGELOG.md").read_text(), flags=re.MULTILINE)
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert headings[0] == project["version"] == version("skyfolio")


def test_ci_runs_the_test_command_of_the_readme() -> None:
    command = "make test"
    assert f"\n{command}\n" in (ROOT / "README.md").read_text()
    assert f"exec {command}\n" in (ROOT / ".ci" / "run").read_text()


def test_pins_are_exact_and_name_no_registry() -> None:
    lines = [line for line in (ROOT / "constraints.txt").read_text().splitlines() if line and not line.startswith("#")]
    assert lines
    for line in lines:
        assert re.fullmatch(r"[A-Za-z0-9._-]+==[0-9][A-Za-z0-9.+!-]*", line), line


def test_every_dependency_is_pinned() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    wanted = [*project["dependencies"], *(one for extra in project["optional-dependencies"].values() for one in extra)]
    pinned = {
        line.split("==")[0].lower().replace("_", "-") for line in (ROOT / "constraints.txt").read_text().split("\n")
    }
    for one in wanted:
        name = re.split(r"[<>=!\[ ;]", one)[0].lower().replace("_", "-")
        assert name in pinned | {"skyfolio"}, name
