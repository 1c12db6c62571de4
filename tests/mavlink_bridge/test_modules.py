"""The modules of the bridge: short, and importing each other one way only, even inside of functions."""

from __future__ import annotations

import ast
from graphlib import TopologicalSorter
from pathlib import Path

BRIDGE = Path(__file__).resolve().parents[2] / "mavlink_bridge"
PACKAGE = "skyfolio.mavlink_bridge"
MOST_LINES = 300
SOURCES = {path.stem: path.read_text() for path in BRIDGE.glob("*.py") if path.stem != "__init__"}


def reached_by(source: str) -> set[str]:
    """Return the bridge's modules that a source imports anywhere; the package itself is ''."""
    reached = set()
    for node in ast.walk(ast.parse(source)):
        names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
        names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
        reached |= {name.removeprefix(PACKAGE).removeprefix(".") for name in names if name.startswith(PACKAGE)}
    return reached


def test_no_module_imports_the_package_that_imports_it_or_takes_part_in_a_circle() -> None:
    graph = {name: reached_by(source) for name, source in SOURCES.items()}
    assert {name for name, reached in graph.items() if "" in reached} == set()
    TopologicalSorter(graph).prepare()  # raises CycleError, naming the circle


def test_every_module_is_short_enough_to_be_read_at_once() -> None:
    lines = {name: source.count("\n") for name, source in SOURCES.items()}
    assert {name: count for name, count in lines.items() if count >= MOST_LINES} == {}
