"""sim.hosts: the parts of an autopilot know protocols, never the autopilot itself."""

import ast
from pathlib import Path

import pytest

SIM = Path(__file__).resolve().parents[2] / "sim"
OWNERS = {"station.py"}
"""What carries a whole autopilot."""


def imports_of(source: Path) -> set[str]:
    """Return the modules that a source names anywhere, for type checkers too."""
    nodes = ast.walk(ast.parse(source.read_text()))
    return {node.module or "" for node in nodes if isinstance(node, ast.ImportFrom)}


@pytest.mark.parametrize("source", sorted(SIM.glob("*.py")), ids=lambda path: path.name)
def test_only_the_station_knows_the_autopilot(source: Path) -> None:
    knows_it = "skyfolio.sim.autopilot" in imports_of(source)
    assert knows_it == (source.name in OWNERS)


@pytest.mark.parametrize("source", sorted(SIM.glob("*.py")), ids=lambda path: path.name)
def test_only_the_autopilot_chooses_a_flavour(source: Path) -> None:
    knows_them = "skyfolio.sim.flavours" in imports_of(source)
    assert knows_them == (source.name == "autopilot.py")
