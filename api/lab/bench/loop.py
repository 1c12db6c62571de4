"""How long one task blocks the event loop, for a large fleet: done at once, and as the service does it.

Everything here is what flights, clients and the dashboard ask of the service while it flies; none of it may hold the
loop for longer than 20 ms, or heartbeats, setpoints and other operations wait.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass
from typing import Any

from skyfolio.api.flights.flown_rates import AT_ONCE, FlownRates
from skyfolio.api.flights.operation_views import OperationView, State
from skyfolio.api.flights.rates import InForce, Sample, rates_by_slot
from skyfolio.api.flights.track import Track
from skyfolio.api.flights.transition import Present, require_separated
from skyfolio.api.http.routes.operations import track_json
from skyfolio.api.plans.contingencies import rows_of
from skyfolio.api.plans.mission_files import Missions
from skyfolio.mavlink_bridge import compile_mission
from skyfolio.mavlink_bridge.ghosts import Airspace
from skyfolio.planner import MaxIterations, Plan, plan
from skyfolio.planner.layouts import scattered

SIZE = (50, 200, 120)
"""UAVs, users, slots."""
SAMPLE_EVERY_S = 0.5
LIMIT_MS = 20.0


@dataclass(frozen=True, kw_only=True)
class Kind:
    """One thing that is asked: `at_once` does all of it, `as_served` the way the service does."""

    at_once: Callable[[], object]
    as_served: Callable[[], Awaitable[object]]


async def loop_figures(size: tuple[int, int, int] = SIZE, runs: int = 3) -> dict[str, Any]:
    """Return, for each kind: milliseconds at once, the longest block of the loop as served, and their ratio.

    Each is the best of `runs`. `over_20_ms`: kinds that block it for longer than they may.
    """
    figures: dict[str, Any] = {"size": "x".join(map(str, size))}
    over = []
    for name, kind in _kinds(plan(scattered(*size, seed=1), n_starts=1, stop=MaxIterations(1))).items():
        at_once_ms = min(_took_ms(kind.at_once) for _ in range(runs))
        held_ms = min([await longest_hold_ms(kind.as_served) for _ in range(runs)])
        figures[name] = {"at_once_ms": at_once_ms, "held_ms": held_ms, "ratio": at_once_ms / held_ms}
        if held_ms > LIMIT_MS:
            over.append(name)
    return {**figures, "over_20_ms": over}


async def longest_hold_ms(work: Callable[[], Awaitable[object]]) -> float:
    """Return the longest time that another task, always ready to run, had to wait while this was done."""
    longest, done = 0.0, False

    async def other() -> None:
        nonlocal longest
        last = time.perf_counter()
        while not done:
            await asyncio.sleep(0)
            now = time.perf_counter()
            longest, last = max(longest, now - last), now

    task = asyncio.create_task(other())
    await asyncio.sleep(0)
    await work()
    await asyncio.sleep(0)
    done = True
    await task
    return longest * 1e3


def _took_ms(work: Callable[[], object]) -> float:
    began = time.perf_counter()
    work()
    return (time.perf_counter() - began) * 1e3


def _kinds(plan: Plan) -> Mapping[str, Kind]:
    timeline, uavs = [InForce(0.0, plan)], plan.scenario.uav_ids
    record = _record(plan)
    samples = [Sample(at, where, frozenset(uavs)) for at, where in record]
    slots, slot_s = plan.scenario.slots, plan.scenario.slot_duration_s
    view = _view(plan)
    live = {uav: path[0] for uav, path in plan.trajectories_m.items()}
    now = Present(0.0, live, plan, Airspace())
    text = plan.model_dump_json()
    missions = Missions(plan)

    def rates(n_samples: int) -> FlownRates:
        track = Track(uavs)
        for at, where in record[:n_samples]:
            track.append(at, where)
        return FlownRates(track, plan.scenario.user_ids, slots, slot_s)

    async def compiled() -> None:
        for uav in uavs:
            compile_mission(plan, uav)
            await asyncio.sleep(0)

    return {
        "all rates of a flight, after a restart": Kind(
            at_once=lambda: rates_by_slot(timeline, samples, slots),
            as_served=lambda: rates(len(record)).settle(timeline, {}),
        ),
        "rates of an operation, when it is read": Kind(
            at_once=lambda: rates_by_slot(timeline, samples, slots),
            as_served=lambda: rates(AT_ONCE).settle(timeline, {}),
        ),
        "operation as JSON": _in_one_go(view.model_dump_json),
        "missions to be flown": Kind(at_once=lambda: [compile_mission(plan, uav) for uav in uavs], as_served=compiled),
        "missions for a client": _beside(missions.as_json),
        "separation of a change": _in_one_go(lambda: require_separated(dict.fromkeys(uavs, plan), now)),
        "plan from JSON": _in_one_go(lambda: Plan.model_validate_json(text)),
        "plan to JSON": _in_one_go(plan.model_dump_json),
        "track as JSON": _beside(lambda: track_json(record)),
        "table of losses": _beside(lambda: rows_of(plan, 0, dict.fromkeys(uavs, plan))),
    }


def _in_one_go(work: Callable[[], object]) -> Kind:
    async def served() -> None:
        work()

    return Kind(at_once=work, as_served=served)


def _beside(work: Callable[[], object]) -> Kind:
    return Kind(at_once=work, as_served=lambda: asyncio.to_thread(work))


def _record(plan: Plan) -> list[tuple[float, dict[str, tuple[float, float]]]]:
    """Return the whole flight on schedule, as it is recorded."""
    slot_s = plan.scenario.slot_duration_s
    times = [SAMPLE_EVERY_S * number for number in range(int(plan.scenario.slots * slot_s / SAMPLE_EVERY_S))]
    return [(at, {uav: path[int(at // slot_s)] for uav, path in plan.trajectories_m.items()}) for at in times]


def _view(plan: Plan) -> OperationView:
    """Return an operation that has flown all its slots."""
    return OperationView(
        id="op",
        version=1,
        state=State.FLYING,
        replanning="auto",
        plan_id=plan.id,
        plan_ids=[plan.id],
        vehicles={uav: number for number, uav in enumerate(plan.scenario.uav_ids, start=1)},
        uavs={},
        lost=[],
        returned=[],
        elapsed_s=0.0,
        slot=0,
        recoveries=[],
        user_rates_bps={user: list(row) for user, row in plan.user_rates_bps.items()},
        error=None,
    )
