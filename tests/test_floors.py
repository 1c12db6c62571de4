"""Imports go down only: api -> mavlink_bridge, sim -> planner."""

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
MAY_IMPORT = {
    "planner": set(),
    "sim": set(),
    "mavlink_bridge": {"planner"},
    "api": {"planner", "mavlink_bridge", "sim"},
}
IMPURE = {
    "asyncio", "fastapi", "http", "httpx2", "io", "logging", "mavsdk", "multiprocessing", "os", "pathlib",
    "pymavlink", "random", "secrets", "shutil", "socket", "structlog", "subprocess", "tempfile", "threading", "time",
    "urllib", "uuid",
}  # fmt: skip
IMPURE_CALLS = {"open", "print", "input"}


def sources(package: str) -> list[Path]:
    return sorted((ROOT / package).rglob("*.py"))


def imported(tree: ast.AST) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "relative imports hide which floor they reach"
            yield node.module or ""


@pytest.mark.parametrize("package", MAY_IMPORT)
def test_a_package_imports_only_from_the_floors_below(package: str) -> None:
    forbidden = set(MAY_IMPORT) - MAY_IMPORT[package] - {package}
    assert sources(package), "the package is there"
    for source in sources(package):
        reached = {name.split(".")[0] for name in imported(ast.parse(source.read_text()))}
        assert not reached & forbidden, f"{source.relative_to(ROOT)} imports {reached & forbidden}"


@pytest.mark.parametrize("source", sources("planner"), ids=lambda path: str(path.relative_to(ROOT)))
def test_the_planner_touches_no_files_sockets_clocks_or_global_random_state(source: Path) -> None:
    tree = ast.parse(source.read_text())
    reached = {name.split(".")[0] for name in imported(tree)}
    assert not reached & IMPURE
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            assert node.func.id not in IMPURE_CALLS
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Attribute) and node.value.attr == "random":
            assert node.attr in {"default_rng", "Generator", "SeedSequence"}, "only seeded generators"


WIRE_FORMAT = {"framing.py", "signing.py"}
"""What MAVSDK has not: cutting a stream into frames, and signing them."""


def test_the_simulator_is_built_on_pymavlink_and_the_bridge_on_mavsdk() -> None:
    for package, foreign in (("sim", "mavsdk"), ("mavlink_bridge", "pymavlink")):
        for source in sources(package):
            reached = {name.split(".")[0] for name in imported(ast.parse(source.read_text()))}
            if package == "mavlink_bridge" and source.name in WIRE_FORMAT:
                continue
            assert foreign not in reached, f"{source.relative_to(ROOT)}: two implementations must test each other"


def test_a_process_that_only_solves_loads_no_web_framework_no_database_and_no_mavlink() -> None:
    look = "import sys, api.solver; print(*{name.split('.')[0] for name in sys.modules})"
    done = subprocess.run([sys.executable, "-c", look], cwd=ROOT, capture_output=True, text=True, check=True)
    assert {"planner", "api"} <= set(done.stdout.split())
    assert not {"fastapi", "sqlalchemy", "mavsdk", "pymavlink", "mavlink_bridge"} & set(done.stdout.split())
