"""Where compiled kernels are kept, on machines that let us write here and there."""

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from skyfolio.api.common import kernels

ROOT = Path(__file__).resolve().parents[2]
NOBODY = 65_534


@pytest.fixture
def machine(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Callable[..., Path]:
    """Run `choose_folder` on a machine with its own code, home and temporary folder, some of them read-only."""
    code, home, temporary = tmp_path / "code", tmp_path / "home", tmp_path / "tmp"
    (code / "fast").mkdir(parents=True)
    (code / "fast" / "kernel.py").write_text("first")
    temporary.mkdir()
    really = kernels._writable

    def choose(*writable: str, variable: str | None = None) -> Path:
        allowed = [tmp_path / name for name in writable]
        monkeypatch.setattr(kernels, "_PLANNER", code)
        monkeypatch.setattr(
            kernels, "_writable", lambda at: any(at.is_relative_to(one) for one in allowed) and really(at)
        )
        monkeypatch.setattr("tempfile.tempdir", str(temporary))
        monkeypatch.setenv("HOME", str(home))
        monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
        monkeypatch.setenv(kernels.REPORTED, "")
        monkeypatch.setenv(kernels.VARIABLE, variable or "")
        monkeypatch.setattr("numba.config.CACHE_DIR", "")
        kernels.choose_folder()
        return kernels.folder().relative_to(tmp_path)

    return choose


def said() -> list[str]:
    lines: list[str] = []
    kernels.report_temporary_folder(lines.append)
    return lines


def test_they_lie_beside_the_sources_where_those_can_be_written(machine: Callable[..., Path]) -> None:
    assert machine("code", "home", "tmp").parts[:2] == ("code", "__pycache__")
    assert said() == []


def test_code_that_lies_among_temporary_files_is_nothing_to_speak_of(
    machine: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert machine("code").parts[:2] == ("code", "__pycache__")
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    assert said() == []


def test_another_user_keeps_them_in_the_own_home(machine: Callable[..., Path]) -> None:
    assert machine("home", "tmp").parts[:3] == ("home", ".cache", "skyfolio")


def test_without_a_home_they_go_into_a_temporary_folder_of_this_user_and_that_is_said_once(
    machine: Callable[..., Path], tmp_path: Path
) -> None:
    place = machine("tmp")
    assert place.parts[:2] == ("tmp", f"skyfolio-{os.getuid()}")
    assert (tmp_path / "tmp" / f"skyfolio-{os.getuid()}").stat().st_mode & 0o777 == 0o700
    (line,) = said()
    assert str(place) in line
    assert said() == []


def test_a_temporary_folder_that_others_can_write_is_not_trusted(machine: Callable[..., Path], tmp_path: Path) -> None:
    planted = tmp_path / "tmp" / f"skyfolio-{os.getuid()}"
    planted.mkdir()
    planted.chmod(0o777)
    place = tmp_path / machine("tmp")
    assert not place.is_relative_to(planted)
    assert place.stat().st_mode & 0o777 == 0o700


def test_a_link_in_the_place_of_the_temporary_folder_is_not_followed(
    machine: Callable[..., Path], tmp_path: Path
) -> None:
    (tmp_path / "elsewhere").mkdir(mode=0o700)
    (tmp_path / "tmp" / f"skyfolio-{os.getuid()}").symlink_to(tmp_path / "elsewhere")
    assert machine("tmp", "elsewhere").parts[1].startswith("skyfolio-kernels-")


def test_a_folder_that_is_given_is_used_unless_it_cannot_be_written(
    machine: Callable[..., Path], tmp_path: Path
) -> None:
    assert machine("code", "given", variable=str(tmp_path / "given")) == Path("given")
    assert machine("code", variable=str(tmp_path / "given")).parts[0] == "code"


def test_what_set_up_has_compiled_beside_sources_that_are_read_only_is_taken_over(
    machine: Callable[..., Path], tmp_path: Path
) -> None:
    installed = tmp_path / machine("code")
    (installed / "fast_1").mkdir()
    (installed / "fast_1" / "kernel.nbc").write_bytes(b"compiled")
    mine = tmp_path / machine("home")
    assert mine != installed
    assert (mine / "fast_1" / "kernel.nbc").read_bytes() == b"compiled"


def test_an_edited_kernel_has_a_place_of_its_own(machine: Callable[..., Path], tmp_path: Path) -> None:
    before = machine("code")
    (tmp_path / "code" / "fast" / "kernel.py").write_text("second")
    assert machine("code") != before


def test_a_kernel_says_that_it_is_compiled_and_a_loaded_one_does_not() -> None:
    from numba import njit  # noqa: PLC0415

    depths: list[int] = []
    triple = njit(lambda x: 3 * x)
    with kernels.compiling(depths.append):
        triple(1)
        compiled = len(depths)
        triple(2)
    assert max(depths) == 1
    assert depths[-1] == 0
    assert len(depths) == compiled


@pytest.mark.skipif(os.getuid() != 0 or not shutil.which("setpriv"), reason="takes another user to be")
def test_another_user_without_a_home_plans_from_code_that_it_cannot_write() -> None:
    environment = {"PATH": os.environ["PATH"], "HOME": "/nonexistent", "PYTHONPATH": str(ROOT)}
    readable = subprocess.run(_as_nobody("-c", "import numba, planner"), env=environment, cwd="/", capture_output=True)
    if readable.returncode:
        pytest.skip("the checkout or the interpreter's packages are not for other users")
    told = []
    try:
        for command in (["--help"], ["plan", "--example", "minimal", "--json"], ["warm-up", "--json"]):
            done = subprocess.run(
                _as_nobody("-m", "skyfolio", *command), env=environment, cwd="/", capture_output=True, text=True
            )
            assert done.returncode == 0, done.stderr[-2000:]
            told.append(done.stderr.count("compiled kernels are kept in"))
    finally:
        shutil.rmtree(f"/tmp/skyfolio-{NOBODY}", ignore_errors=True)  # noqa: S108
    assert told == [0, 1, 1]
    assert json.loads(done.stdout)["compiled"] == 0


def _as_nobody(*arguments: str) -> list[str]:
    return ["setpriv", f"--reuid={NOBODY}", f"--regid={NOBODY}", "--clear-groups", sys.executable, *arguments]
