"""The wheel holds the whole product under one import name, and nothing else."""

import shutil
import subprocess
import sys
import tomllib
from pathlib import Path, PurePosixPath
from zipfile import ZipFile

import pytest

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
FOLDERS = ("planner", "mavlink_bridge", "sim", "api")
DATA = {".css", ".js", ".mako"}


def sources() -> set[PurePosixPath]:
    """Return every file of the four folders by the path that it has once installed."""
    paths = set()
    for folder in FOLDERS:
        for file in (ROOT / folder).rglob("*"):
            inside = file.relative_to(ROOT)
            if file.is_file() and "__pycache__" not in inside.parts:
                at_top = inside.parts[:2] == ("api", "skyfolio")  # what `import skyfolio` itself gives
                paths.add(PurePosixPath("skyfolio", *(inside.parts[2:] if at_top else inside.parts)))
    return paths


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> set[PurePosixPath]:
    """Build a wheel from a copy, so that nothing is left behind, and return the paths in it."""
    copy, out = tmp_path_factory.mktemp("copy"), tmp_path_factory.mktemp("out")
    for folder in FOLDERS:
        shutil.copytree(ROOT / folder, copy / folder, ignore=shutil.ignore_patterns("__pycache__"))
    for file in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / file, copy)
    options = ["--no-index", "--no-deps", "--no-build-isolation", "--wheel-dir", str(out)]
    command = [sys.executable, "-m", "pip", "wheel", *options, str(copy)]
    built = subprocess.run(command, capture_output=True, text=True)
    assert built.returncode == 0, built.stdout + built.stderr
    (built_wheel,) = out.glob("*.whl")
    with ZipFile(built_wheel) as opened:
        return {PurePosixPath(name) for name in opened.namelist()}


def test_only_skyfolio_and_its_metadata_are_at_the_top(wheel: set[PurePosixPath]) -> None:
    version = PROJECT["project"]["version"]
    assert {path.parts[0] for path in wheel} == {"skyfolio", f"skyfolio-{version}.dist-info"}


def test_every_module_and_every_data_file_is_inside(wheel: set[PurePosixPath]) -> None:
    assert sources() - wheel == set()
    assert {path for path in wheel if path.parts[0] == "skyfolio"} - sources() == set()
    assert {path.suffix for path in wheel} >= DATA
    assert PurePosixPath("skyfolio/py.typed") in wheel


def test_every_package_of_the_folders_is_listed() -> None:
    packages = {".".join(path.parts[:-1]) for path in sources() if path.suffix == ".py"}
    assert set(PROJECT["tool"]["setuptools"]["packages"]) == packages
