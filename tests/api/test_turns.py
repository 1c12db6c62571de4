"""What takes long for a large fleet is done beside the event loop, or in pieces between which others take turns."""

import asyncio
import json
import threading
from collections.abc import AsyncIterator, Callable, Iterable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import pytest_asyncio
from sqlalchemy import insert

from skyfolio.api.common.idempotency import fresh
from skyfolio.api.common.settings import Settings
from skyfolio.api.dashboard.feed import TRACK_AT_ONCE, Feed
from skyfolio.api.dashboard.rest import Rest
from skyfolio.api.flights.assigned_missions import AssignedMission, AssignedMissionStore
from skyfolio.api.flights.swap import Swap
from skyfolio.api.flights.take_off import FlightError, TakeOff
from skyfolio.api.http.app import create_app
from skyfolio.api.plans import contingencies
from skyfolio.api.plans.contingencies import Contingencies
from skyfolio.api.plans.mission_files import Missions
from skyfolio.api.plans.solver import LaneName
from skyfolio.api.service import Service
from skyfolio.api.store.tables import operations, track
from skyfolio.planner import EXAMPLES, Plan, plan, replan


@pytest.fixture(scope="module")
def made() -> Plan:
    return plan(EXAMPLES["minimal"]())


@pytest_asyncio.fixture
async def served(tmp_path: Path) -> AsyncIterator[tuple[Service, Rest]]:
    app = create_app(Settings(database_url=f"sqlite+aiosqlite:///{tmp_path}/service.db", warm_up=False))
    async with app.router.lifespan_context(app):
        yield app.state.service, Rest(app)


def watched(monkeypatch: pytest.MonkeyPatch, owner: Any, name: str) -> list[bool]:
    """Whether each call of this function was made on the thread that the test, and the event loop, run on."""
    real, here, calls = getattr(owner, name), threading.get_ident(), list[bool]()

    def instead(*args: Any, **options: Any) -> Any:
        calls.append(threading.get_ident() == here)
        return real(*args, **options)

    monkeypatch.setattr(owner, name, instead)
    return calls


class Turns:
    """Counts how often something else ran, while somebody else works."""

    def __init__(self) -> None:
        self.count = 0

    async def while_it(self, work: Any) -> Any:
        task = asyncio.create_task(self._other())
        try:
            return await work
        finally:
            task.cancel()

    async def _other(self) -> None:
        while True:
            self.count += 1
            await asyncio.sleep(0)


async def test_missions_are_compiled_for_clients_beside_the_loop(
    served: tuple[Service, Rest], made: Plan, monkeypatch: pytest.MonkeyPatch
) -> None:
    service, rest = served
    known = await service.plans.adopt(made, fresh("plan"))
    on_the_loop = watched(monkeypatch, Missions, "_mission")
    missions = await rest.call("GET", f"/v1/plans/{known.id}/missions")
    assert set(missions) == {"uav-1", "uav-2"}
    assert on_the_loop == [False, False]


async def with_track(service: Service, points: int) -> list[float]:
    """Store an operation that flew so long; when everybody was heard."""
    times = [0.5 * number for number in range(points)]
    row = {"id": "op-1", "number": 1, "created_at": 0.0, "plan_id": "plan-1", "policy": "auto", "state": "completed"}
    await service.database.write((insert(operations), {**row, "version": 0, "document": "{}"}))
    where = json.dumps({"uav-1": (1.0, 2.0)})
    rows = [{"operation_id": "op-1", "elapsed_s": at, "positions": where} for at in times]
    await service.database.write((insert(track), rows))
    return times


async def test_a_long_track_is_read_piece_by_piece(served: tuple[Service, Rest]) -> None:
    service, rest = served
    times = await with_track(service, 2 * TRACK_AT_ONCE + 50)
    whole = await rest.call("GET", "/v1/operations/op-1/track")
    assert [point["elapsed_s"] for point in whole] == times
    assert whole[0]["positions_m"] == {"uav-1": [1.0, 2.0]}
    asked = list[Any]()
    text = rest.text

    async def noted(method: str, path: str, **params: Any) -> str:
        asked.append(params["after_s"])
        return await text(method, path, **params)

    rest.text = noted  # type: ignore[method-assign]
    points = await Feed(rest).track("op-1")
    assert [point.elapsed_s for point in points] == times
    assert points[0].positions_m == {"uav-1": (1.0, 2.0)}
    assert asked == [None, times[TRACK_AT_ONCE - 1], times[2 * TRACK_AT_ONCE - 1]]


async def test_a_track_is_decoded_and_encoded_beside_the_loop(
    served: tuple[Service, Rest], monkeypatch: pytest.MonkeyPatch
) -> None:
    service, _ = served
    await with_track(service, 3)
    on_the_loop = watched(monkeypatch, json, "loads")
    await service.operations.track("op-1", None, None)
    assert on_the_loop == [False] * 3


async def test_stored_missions_are_written_and_read_beside_the_loop(
    served: tuple[Service, Rest], made: Plan, monkeypatch: pytest.MonkeyPatch
) -> None:
    service, _ = served
    await with_track(service, 1)
    scenario = made.scenario
    assigned = {
        uav: AssignedMission(
            mission=Missions(made)._mission(uav),
            path_m=list(made.trajectories_m[uav]),
            first_slot=0,
            slot_s=scenario.slot_duration_s,
            origin=scenario.origin,
            altitude_m=60.0,
        )
        for uav in scenario.uav_ids
    }
    dumped, loaded = watched(monkeypatch, json, "dumps"), watched(monkeypatch, json, "loads")
    store = AssignedMissionStore(service.database, "op-1")
    await store.write(assigned)
    assert set(await store.read()) == set(assigned)
    assert dumped == loaded == [False, False]


class Rows:
    """A database that has these rows, and counts who asks for them."""

    def __init__(self, rows: Iterable[Any]) -> None:
        self.stored, self.asked = list(rows), 0

    async def rows(self, _wanted: Any) -> list[Any]:
        self.asked += 1
        return self.stored


async def test_stored_plans_ahead_are_read_once_for_all_uavs_and_in_turns(
    made: Plan, monkeypatch: pytest.MonkeyPatch
) -> None:
    uavs = made.scenario.uav_ids
    rows = [
        SimpleNamespace(
            uav_id=uav,
            disruption_weight=0.0,
            result=replan(made, failed=[uav], at_slot=2).model_dump_json(),
            error=None,
        )
        for uav in uavs
    ]
    database, turns = Rows(rows), Turns()
    ahead = Contingencies({LaneName.AHEAD: None}, database)  # type: ignore[arg-type]
    await turns.while_it(ahead.make(made, 2, uavs))
    assert database.asked == 1
    assert turns.count >= len(uavs)
    rows_made_here = watched(monkeypatch, contingencies, "_row")
    assert {row.uav_id for row in await ahead.table_of(made, 2, wait_s=1.0)} == set(uavs)
    assert database.asked == 1
    assert rows_made_here == [False, False]


class Guidance:
    """Compiles nothing, and remembers when it was asked to."""

    def __init__(self, turns: Turns) -> None:
        self.turns, self.seen = turns, list[int]()

    def compile(self, _plan: Plan, uav: str, **_options: Any) -> str:
        self.seen.append(self.turns.count)
        return uav

    def audit(self, _plan: Plan) -> dict[str, Any]:
        raise FlightError("far enough")


async def nothing(*_args: Any, **_options: Any) -> None:
    """What the link does here."""


def taking_off(made: Plan, guidance: Guidance) -> Any:
    link = SimpleNamespace(wait_for=nothing, prepare=nothing, wait_for_facts=nothing)
    clock = SimpleNamespace(now=lambda: 0.0)
    systems = {"uav-1": 1, "uav-2": 2}
    take_off = TakeOff(made, systems, SimpleNamespace(link=link, enforces_preflight=False), clock, guidance)  # type: ignore[arg-type]

    async def upload() -> None:
        with pytest.raises(FlightError, match="far enough"):
            await take_off.upload()

    return upload()


def swapping(made: Plan, guidance: Guidance) -> Any:
    live = {uav: path[0] for uav, path in made.trajectories_m.items()}
    flight = SimpleNamespace(guidance=guidance, slot_s=5.0, positions_m=lambda: live, now_s=lambda: 1.0)
    swap = Swap(flight, None, None, attempts=1)  # type: ignore[arg-type]
    return swap._missions(made, made.scenario.uav_ids)


@pytest.mark.parametrize("way", [taking_off, swapping])
async def test_others_take_turns_between_the_missions_of_a_fleet(
    made: Plan, way: Callable[[Plan, Guidance], Any]
) -> None:
    turns = Turns()
    guidance = Guidance(turns)
    await turns.while_it(way(made, guidance))
    assert len(guidance.seen) == 2
    assert guidance.seen[1] > guidance.seen[0]
