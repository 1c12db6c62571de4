"""Imports go down only: between the four packages, and between the rooms of `api`; no two modules import each other."""

import ast
import subprocess
import sys
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
MAY_IMPORT = {
    "planner": set(),
    "sim": set(),
    "mavlink_bridge": {"planner"},
    "api": {"planner", "mavlink_bridge", "sim"},
}
ROOMS = {
    "common": set(),
    "store": {"common"},
    "access": {"common", "store"},
    "plans": {"common", "store"},
    "places": {"common"},
    "fleet": {"common", "store"},
    "flights": {"common", "store", "plans", "fleet"},
    "webhooks": {"common", "store", "flights"},
    "service": {"common", "store", "access", "plans", "fleet", "flights", "webhooks"},
    "http": {"common", "store", "access", "places", "plans", "fleet", "flights", "service", "dashboard", "webhooks"},
    "client": {"common", "plans", "fleet", "flights", "store", "webhooks"},
    "dashboard": {"common", "client"},
    "cli": {"common", "store", "access", "places", "plans", "fleet", "flights", "http", "client", "lab"},
    "lab": {"common", "store", "plans", "fleet", "flights", "service", "http", "client"},
}
"""What each room of `api` may import. `dashboard` sees the service as a client does, and no room of the service knows
`lab`."""
IMPURE = {
    "asyncio", "fastapi", "http", "httpx2", "io", "logging", "mavsdk", "multiprocessing", "os", "pathlib",
    "pymavlink", "random", "secrets", "shutil", "socket", "structlog", "subprocess", "tempfile", "threading", "time",
    "urllib", "uuid",
}  # fmt: skip
IMPURE_CALLS = {"open", "print", "input"}
PREFIX = "skyfolio."


def sources(package: str) -> list[Path]:
    return sorted((ROOT / package).rglob("*.py"))


def imported(tree: ast.AST) -> Iterator[str]:
    """Every module that the source may name, without `skyfolio.`; an imported name may be a module itself."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name.removeprefix(PREFIX) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "relative imports hide which floor they reach"
            module = node.module or ""
            base = "" if module == "skyfolio" else module.removeprefix(PREFIX) + "."
            yield from (f"{base}{alias.name}" for alias in node.names)


def reached_by(source: Path) -> set[str]:
    return set(imported(ast.parse(source.read_text())))


@pytest.mark.parametrize("package", MAY_IMPORT)
def test_a_package_imports_only_from_the_floors_below(package: str) -> None:
    forbidden = set(MAY_IMPORT) - MAY_IMPORT[package] - {package}
    assert sources(package), "the package is there"
    for source in sources(package):
        if source.parent.name != "skyfolio":  # what `import skyfolio` itself gives
            reached = {name.split(".")[0] for name in reached_by(source)}
            assert not reached & forbidden, f"{source.relative_to(ROOT)} imports {reached & forbidden}"


def room_of(module: str) -> str:
    return module.split(".")[1] if module.startswith("api.") else ""


def test_the_rooms_of_the_service_are_all_known() -> None:
    folders = {path.name for path in (ROOT / "api").iterdir() if path.is_dir() and (path / "__init__.py").exists()}
    assert folders - {"skyfolio"} == set(ROOMS) - {"service"}
    assert {path.stem for path in (ROOT / "api").glob("*.py")} == {"__init__", "service"}


@pytest.mark.parametrize("room", ROOMS)
def test_a_room_of_the_service_imports_only_what_it_may(room: str) -> None:
    own = [ROOT / "api" / "service.py"] if room == "service" else sources(f"api/{room}")
    for source in own:
        reached = {room_of(name) for name in reached_by(source)} - {"", room}
        assert reached <= ROOMS[room], f"{source.relative_to(ROOT)} imports {reached - ROOMS[room]}"


def modules() -> dict[str, Path]:
    """Every module of the product by its name without `skyfolio.`; a package is its `__init__`."""
    found = {}
    for package in MAY_IMPORT:
        for source in sources(package):
            parts = source.relative_to(ROOT).with_suffix("").parts
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = source
    return found


def at_import(tree: ast.Module) -> Iterator[ast.stmt]:
    """Statements that run, or that type checkers read, when the module is imported; functions import later."""
    for node in tree.body:
        yield node
        if isinstance(node, ast.If | ast.Try):
            yield from node.body


def edges_of(name: str, source: Path, known: dict[str, Path]) -> set[str]:
    tree = ast.Module(body=list(at_import(ast.parse(source.read_text()))), type_ignores=[])
    reached = set()
    for target in imported(tree):
        module = target
        while module and module not in known:
            module = module.rpartition(".")[0]
        reached.add(module)
    package = name if source.name == "__init__.py" else name.rpartition(".")[0]
    return reached - {"", name} - ({package} if source.name != "__init__.py" else set())


def test_no_two_modules_import_each_other() -> None:
    known = modules()
    graph = {name: edges_of(name, source, known) for name, source in known.items() if source.parent.name != "skyfolio"}
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        pytest.fail(" -> ".join(error.args[1]))


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
            reached = {name.split(".")[0] for name in reached_by(source)}
            if package == "mavlink_bridge" and source.name in WIRE_FORMAT:
                continue
            assert foreign not in reached, f"{source.relative_to(ROOT)}: two implementations must test each other"


def test_a_process_that_only_solves_loads_no_web_framework_no_database_and_no_mavlink() -> None:
    look = "import sys, skyfolio.api.plans.solver; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", look], cwd=ROOT, capture_output=True, text=True, check=True)
    loaded = set(done.stdout.split())
    assert "skyfolio.planner" in loaded
    assert not {"fastapi", "sqlalchemy", "mavsdk", "pymavlink", "skyfolio.mavlink_bridge"} & loaded


@pytest.mark.parametrize("name", ["planner", "mavlink_bridge", "sim", "api"])
def test_installed_everything_lives_under_one_import_name(name: str, tmp_path: Path) -> None:
    look = (
        f"import importlib.util as u; print(u.find_spec('skyfolio.{name}') is not None, u.find_spec('{name}') is None)"
    )
    done = subprocess.run([sys.executable, "-c", look], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["True", "True"]
