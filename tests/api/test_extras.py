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
    ],
)
@pytest.mark.usefixtures("without_extras")
def test_what_needs_a_missing_extra_ends_at_once_with_its_name(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], arguments: str, message: str
) -> None:
    monkeypatch.setattr(sys, "argv", ["skyfolio", *arguments.split()])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    error = capsys.readouterr().err
    extra = "postgres" if "asyncpg" in message else "plots"
    assert f"{message}, which is not installed: pip install 'skyfolio[{extra}]'" in error


def test_every_extra_installs_its_module_and_development_installs_all() -> None:
    declared: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    assert {extra for extra in declared if extra != "dev"} == set(extras.EXTRAS.values())
    for module, extra in extras.EXTRAS.items():
        assert [requirement.split(">=")[0] for requirement in declared[extra]] == [module]
    assert "skyfolio[plots,postgres]" in declared["dev"]
