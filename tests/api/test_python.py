"""The public Python API: its names, its page, plans as arrays and tables, GeoJSON, what other packages add, clients."""

from __future__ import annotations

import inspect
import json
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal

import httpx2
import numpy as np
import pytest
from pydantic import Field, ValidationError

import skyfolio
from skyfolio import EXAMPLES, AsyncClient, Client, Plan, Scenario, plan
from skyfolio.api.client import ApiError
from skyfolio.api.common.settings import Settings
from skyfolio.api.http.app import create_app
from skyfolio.api.places.files import SourceFile
from skyfolio.api.places.importing import import_files
from skyfolio.api.places.writing import write_scenario
from skyfolio.planner.arrays import Array
from skyfolio.planner.channels.kinds import KINDS
from skyfolio.planner.channels.radio import RadioChannel
from skyfolio.planner.methods import METHODS
from skyfolio.planner.no_fly import NoFlyDisc, NoFlyPolygon
from skyfolio.planner.utilities import UTILITIES, Kind

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "python.md").read_text()
BLOCKS = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)


@pytest.fixture
def as_before() -> Iterator[None]:
    """Forget afterwards what a test has registered."""
    tables: list[dict[str, Any]] = [METHODS, UTILITIES, KINDS]
    were = [dict(table) for table in tables]
    yield
    for table, was in zip(tables, were, strict=True):
        table.clear()
        table.update(was)


@pytest.fixture(scope="module")
def made() -> Plan:
    return plan(EXAMPLES["minimal"](), n_starts=2)


# -- names ------------------------------------------------------------------------------------------------------------


def test_the_page_lists_every_public_name_and_no_other() -> None:
    rows = re.findall(r"^\| (`[^|]*`) \|", PAGE, re.MULTILINE)
    assert sorted(name for row in rows for name in re.findall(r"`(\w+)`", row)) == sorted(skyfolio.__all__)
    for name in skyfolio.__all__:
        assert getattr(skyfolio, name) is not None, name


def test_nothing_else_is_exported() -> None:
    look = (
        "import skyfolio; [getattr(skyfolio, name) for name in skyfolio.__all__];"
        "print(*dir(skyfolio)); print(*(n for n, v in vars(skyfolio).items() if not n.startswith('_')"
        " and type(v).__name__ != 'module'))"
    )
    done = subprocess.run([sys.executable, "-c", look], cwd=ROOT, capture_output=True, text=True, check=True)
    offered, there = (line.split() for line in done.stdout.splitlines())
    assert offered == sorted(skyfolio.__all__)
    assert set(there) <= {*skyfolio.__all__, "TYPE_CHECKING", "Any"}
    with pytest.raises(AttributeError, match="no attribute 'optimise'"):
        skyfolio.optimise  # noqa: B018


def test_importing_the_package_loads_neither_numpy_nor_the_service() -> None:
    done = subprocess.run(
        [sys.executable, "-c", "import sys, skyfolio; print(*sys.modules)"], capture_output=True, text=True, check=True
    )
    assert not {"numpy", "pydantic", "fastapi", "numba"} & set(done.stdout.split())


@pytest.mark.usefixtures("as_before")
@pytest.mark.parametrize("block", [block for block in BLOCKS if "Client" not in block], ids=lambda block: block[:40])
def test_what_the_page_shows_runs(block: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "Agg")
    known: dict[str, Any] = {}
    exec(compile(block, "docs/python.md", "exec"), known)  # noqa: S102 - our own page
    if "savefig" in block:
        assert len([line for line in block.splitlines() if line.strip()]) <= 10
        assert "<svg" in (tmp_path / "trade-off.svg").read_text()
        assert known["table"]["Jain index"].is_monotonic_increasing
    if "to_arrays" in block:
        rates = [np.mean(rates) for rates in known["made"].user_rates_bps.values()]
        assert known["worst"] == pytest.approx(min(rates))
        assert known["served"] == pytest.approx(np.sum(list(known["made"].user_rates_bps.values()), axis=0) / 1e3)
    if "average_user" in block:
        assert known["made"].scenario.utility.kind == "average_user"


# -- arrays and tables ------------------------------------------------------------------------------------------------


def test_arrays_hold_the_plan_by_index(made: Plan) -> None:
    arrays = made.to_arrays()
    scenario = made.scenario
    assert arrays.paths_m.shape == (len(scenario.uavs), scenario.slots, 2)
    assert arrays.serving.shape == arrays.rates_bps.shape == (len(scenario.users), scenario.slots)
    for u, uav in enumerate(arrays.uav_ids):
        assert arrays.paths_m[u].tolist() == [list(point) for point in made.trajectories_m[uav]]
    names = [*arrays.uav_ids, ""]
    for k, user in enumerate(arrays.user_ids):
        assert [names[index] for index in arrays.serving[k]] == made.association[user]
        assert arrays.rates_bps[k].tolist() == made.user_rates_bps[user]
    assert arrays.begins_s.tolist() == [5.0 * slot for slot in range(scenario.slots)]
    assert set(arrays.altitudes_m.ravel()) == {scenario.altitude_m}


def test_tables_have_a_row_for_each_slot_and_user_or_uav_on_the_clock_of_the_operation(made: Plan) -> None:
    rest = skyfolio.replan(made, failed=["uav-1"], at_slot=2)
    users, uavs = rest.to_frame(), rest.to_frame("uavs")
    assert users["slot"].min() == uavs["slot"].min() == 2
    assert users["begins_s"].min() == 10.0
    assert len(users) == rest.scenario.slots * len(rest.scenario.users)
    for row in users.itertuples():
        assert row.uav_id == rest.association[row.user_id][row.slot - 2]
        assert row.rate_bps == rest.user_rates_bps[row.user_id][row.slot - 2]
    for row in uavs.itertuples():
        assert (row.east_m, row.north_m) == rest.trajectories_m[row.uav_id][row.slot - 2]


def test_a_table_without_pandas_is_an_error_that_says_what_to_install(
    made: Plan, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(ImportError, match=r"pip install pandas"):
        made.to_frame()


# -- GeoJSON ----------------------------------------------------------------------------------------------------------


def zoned() -> Scenario:
    disc = NoFlyDisc(center_m=(150.0, 20.0), radius_m=10.0)
    triangle = NoFlyPolygon(vertices_m=((140.0, 70.0), (160.0, 70.0), (150.0, 90.0)))
    return EXAMPLES["minimal"]().with_changes(no_fly=(disc, triangle))


@pytest.mark.parametrize("parsed", [True, False])
def test_geojson_gives_the_scenario_that_was_exported_as_the_import_of_files_does(parsed: bool) -> None:
    scenario = zoned()
    text = write_scenario(scenario, "geojson")
    read = Scenario.from_geojson(json.loads(text) if parsed else text)
    imported = import_files([SourceFile(name="own.geojson", content=text.encode())]).scenario
    for one in (read, imported):
        assert (one.uav_ids, one.user_ids, one.slots, one.utility) == (
            scenario.uav_ids, scenario.user_ids, scenario.slots, scenario.utility,
        )  # fmt: skip
        assert [user.position_m for user in one.users] == [user.position_m for user in scenario.users]
        assert [uav.start_m for uav in one.uavs] == [uav.start_m for uav in scenario.uavs]
        assert np.array(one.area_m) == pytest.approx(np.array(scenario.area_m), abs=0.3)
        assert [zone.kind for zone in one.no_fly[:2]] == ["disc", "polygon"]
    assert Scenario.from_geojson(text, slots=9).slots == 9


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"type": "Feature"}, "type: a scenario is a FeatureCollection"),
        ({"properties": {"kind": "tree"}}, r"features\.0\.properties\.kind: 'tree' must be one of user, uav"),
        ({"geometry": {"type": "Polygon"}}, r"features\.0\.geometry\.type: of kind user it must be Point or LineStr"),
        ({"properties": {"kind": "user", "min_rate_bps": -1.0}}, "users.0.min_rate_bps"),
    ],
)
def test_geojson_that_is_no_scenario_is_an_error_that_names_the_feature(change: dict[str, Any], said: str) -> None:
    document = json.loads(write_scenario(EXAMPLES["minimal"](), "geojson"))
    document["features"] = [one for one in document["features"] if one["properties"]["kind"] != "area"]
    if "type" in change:
        document |= change
    else:
        document["features"][0] |= change
    with pytest.raises(ValueError, match=said):
        Scenario.from_geojson(document, area_m=((0, 0), (300, 200)))


def test_files_are_read_at_the_edge(tmp_path: Path) -> None:
    json_file, geojson = tmp_path / "own.json", tmp_path / "own.geojson"
    json_file.write_text(EXAMPLES["minimal"]().model_dump_json())
    geojson.write_text(write_scenario(EXAMPLES["minimal"](), "geojson"))
    assert skyfolio.read_scenario(json_file) == EXAMPLES["minimal"]()
    assert skyfolio.read_scenario(str(geojson), slots=7).slots == 7


# -- what other packages add ------------------------------------------------------------------------------------------


class LogDistance(RadioChannel):
    """A loss that grows by ten times an exponent in each decade of distance."""

    kind: Literal["log_distance"] = "log_distance"
    exponent: Annotated[float, Field(strict=True, ge=1, le=6)] = 2.7

    def power_gain(self, away_m: Array, distance_m: Array, height_m: Array) -> Array:  # noqa: ARG002
        """Return the gain at these distances in space."""
        gain: Array = 1e-2 / distance_m**self.exponent
        return gain


@pytest.mark.usefixtures("as_before")
def test_a_registered_channel_is_planned_with_written_read_and_described() -> None:
    given = {"kind": "log_distance", "exponent": 2.5}
    with pytest.raises(ValidationError, match="no such kind of channel"):
        EXAMPLES["minimal"]().with_changes(channel=given)
    assert skyfolio.register_channel(LogDistance) is LogDistance
    scenario = EXAMPLES["minimal"]().with_changes(channel=given)
    made = plan(scenario, n_starts=1)
    assert Plan.model_validate_json(made.model_dump_json()) == made
    assert made.scenario.channel == LogDistance(exponent=2.5)
    assert skyfolio.violations(made) == []
    assert "log_distance" in json.dumps(Scenario.model_json_schema())


@pytest.mark.usefixtures("as_before")
def test_a_registered_method_and_utility_have_names_that_are_given_once() -> None:
    def still(problem: Any, *args: Any, **named: Any) -> Any:
        return METHODS["static"](problem, *args, **named)

    skyfolio.register_method("still", still)
    skyfolio.register_method("still", still)  # the same again
    made = plan(EXAMPLES["minimal"](), method="still")
    assert made.method == "still"
    assert {len(set(path)) for path in made.trajectories_m.values()} == {1}
    skyfolio.register_utility("as_sum", UTILITIES["sum"])
    assert "as_sum" in json.dumps(skyfolio.Utility.model_json_schema())
    assert plan(EXAMPLES["minimal"]().with_changes(utility={"kind": "as_sum"}), n_starts=1).summary.utility_bps > 0
    for again in (
        lambda: skyfolio.register_method("still", METHODS["static"]),
        lambda: skyfolio.register_utility("sum", UTILITIES["pooled"]),
        lambda: skyfolio.register_method("no name", still),
        lambda: skyfolio.register_channel(Kind),  # type: ignore[type-var]
        lambda: skyfolio.register_channel(RadioChannel),
    ):
        with pytest.raises(ValueError, match=r"taken|must be"):
            again()


PLUGIN = """
from skyfolio import register_utility
from skyfolio.planner.utilities import UTILITIES

def register():
    register_utility("theirs", UTILITIES["pooled"])
"""


def installed(folder: Path, code: str) -> dict[str, str]:
    """The environment in which another package is installed beside this one."""
    (folder / "theirs.py").write_text(code)
    info = folder / "theirs-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: theirs\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[skyfolio.plugins]\ntheirs = theirs:register\n")
    import os  # noqa: PLC0415

    return {**os.environ, "PYTHONPATH": f"{folder}:{os.environ.get('PYTHONPATH', '')}"}


def test_what_an_installed_package_offers_is_known_to_commands(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "skyfolio", "plan", "--example", "minimal", "--utility", "theirs", "--json"]
    refused = subprocess.run(command, capture_output=True, text=True)
    assert refused.returncode == 2
    assert "utility.kind: Input should be 'sum', 'per_user' or 'pooled'" in refused.stderr
    done = subprocess.run(command, env=installed(tmp_path, PLUGIN), capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["scenario"]["utility"]["kind"] == "theirs"


def test_a_package_that_cannot_be_loaded_is_an_error_that_names_it(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "skyfolio", "plan", "--example", "minimal"]
    done = subprocess.run(command, env=installed(tmp_path, "1 / 0"), capture_output=True, text=True)
    assert done.returncode == 2
    assert done.stderr == "error: plug-in theirs of theirs: ZeroDivisionError: division by zero\n"


# -- clients ----------------------------------------------------------------------------------------------------------


def test_the_client_for_asyncio_has_every_method_of_the_other() -> None:
    own = {"call", "pages"}
    for name, method in inspect.getmembers(Client, inspect.isfunction):
        if not name.startswith("_") and name not in own:
            there = getattr(AsyncClient, name)
            assert inspect.signature(there) == inspect.signature(method) or name in {"events", "close"}, name


async def test_it_plans_lists_listens_and_raises_as_the_other_does() -> None:
    app = create_app(Settings())
    http = httpx2.AsyncClient(transport=httpx2.ASGITransport(app), base_url="http://testserver")
    async with app.router.lifespan_context(app), AsyncClient(http=http) as service:
        made = await service.plan(EXAMPLES["minimal"]())
        assert isinstance(made, Plan)
        assert [row.id async for row in service.plans()] == [made.id]
        kinds = [event.kind async for event in service.events(follow=False)]
        assert "plan_ended" in kinds
        with pytest.raises(ApiError) as refused:
            await service.read_plan("plan-none")
        assert refused.value.status == 404
