"""Optional dependencies: a clear error names the extra before any work is done."""

import sys
import tomllib
from importlib import util
from pathlib import Path
from typing import Any

import pytest

from skyfolio.api.cli.main import main
from skyfolio.api.common import extras

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def without_extras(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make all optional modules look as if they were not installed."""
    real = util.find_spec
    monkeypatch.setattr(extras, "find_spec", lambda name: None if name in extras.EXTRAS else real(name))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("keys list --database-url postgresql+asyncpg://x@127.0.0.1:9/x", "database_url: PostgreSQL needs asyncpg"),
        ("demo", "the report of the drill needs matplotlib"),
        ("reproduce", "drawing the figures needs matplotlib"),
        ("tune-mu --plot out.png", "--plot needs matplotlib"),
        ("sweep SPEC", "a sweep needs cryptography"),
    ],
)
@pytest.mark.usefixtures("without_extras")
def test_what_needs_a_missing_extra_ends_at_once_with_its_name(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path, arguments: str, message: str
) -> None:
    (tmp_path / "study.toml").write_text('[base]\nexample = "minimal"\n')
    monkeypatch.setattr(sys, "argv", ["skyfolio", *arguments.replace("SPEC", str(tmp_path / "study.toml")).split()])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    error = capsys.readouterr().err
    extra = extras.EXTRAS[message.rpartition(" ")[2]]
    assert f"{message}, which is not installed: pip install 'skyfolio[{extra}]'" in error


@pytest.mark.usefixtures("without_extras")
def test_a_service_that_is_to_solve_on_dask_without_it_does_not_start(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("SKYFOLIO_SOLVER", "dask+tcp://127.0.0.1:9")
    monkeypatch.setattr(sys, "argv", ["skyfolio", "serve", "--port", "0", "--database-url", "temporary"])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    error = capsys.readouterr().err
    assert "solver: Dask needs cryptography, which is not installed: pip install 'skyfolio[sweep]'" in error


def test_every_extra_installs_its_module_and_development_installs_all() -> None:
    declared: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    assert {extra for extra in declared if extra != "dev"} == set(extras.EXTRAS.values())
    for extra in set(extras.EXTRAS.values()):
        modules = [module for module, its_extra in extras.EXTRAS.items() if its_extra == extra]
        assert [requirement.split(">=")[0] for requirement in declared[extra]] == modules
    assert "skyfolio[plots,postgres,sweep]" in declared["dev"]
