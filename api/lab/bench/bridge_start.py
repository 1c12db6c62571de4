"""How far apart vehicles truly begin slot 0, by the ground truth: real sockets, lossy links."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

from skyfolio import sim
from skyfolio.api.lab.bench.bridge_sockets import hovering
from skyfolio.api.lab.bench.measure import quantile
from skyfolio.api.lab.bench.tracks import moving_plan
from skyfolio.mavlink_bridge import Autopilot, FleetLink

VEHICLES, ALTITUDE_M, SPEEDUP = 8, 8.0, 2.0


async def start_row(autopilot: Autopilot, loss: float, starts: int) -> dict[str, Any]:
    """Measure starts of eight vehicles, over and over.

    `spread`: from the first to the last, `late`: from the order to the last; wall seconds.
    """
    spreads, lates, failures = [], [], 0
    async with _hovering(autopilot, loss) as (fleet, link):
        for _ in range(starts):
            told_s: list[float] = []
            first = len(fleet.truth.events)
            results = await link.start(fleet.vehicles, on_go=lambda told_s=told_s: told_s.append(fleet.clock.now()))  # type: ignore[misc]
            began: dict[int, float] = {}
            for event in fleet.truth.events[first:]:
                if event.kind == "mode" and event.detail["mode"] == sim.Mode.MISSION.name:
                    began.setdefault(event.system_id, event.t_s)
            if len(began) == VEHICLES and all(result.ok for result in results.values()):
                spreads.append((max(began.values()) - min(began.values())) / SPEEDUP)
                lates.append((max(began.values()) - told_s[0]) / SPEEDUP)
            else:
                failures += 1
            while any(vehicle.mode is sim.Mode.MISSION for vehicle in fleet.vehicles.values()):
                await link.hold(fleet.vehicles)
    return {
        "autopilot": autopilot.value,
        "uavs": VEHICLES,
        "loss_each_way": loss,
        "starts": starts,
        "failures": failures,
        "spread_p50_s": round(quantile(spreads, 0.5), 3),
        "spread_p95_s": round(quantile(spreads, 0.95), 3),
        "spread_max_s": round(max(spreads), 3),
        "late_p95_s": round(quantile(lates, 0.95), 3),
    }


@asynccontextmanager
async def _hovering(autopilot: Autopilot, loss: float) -> AsyncIterator[tuple[sim.Fleet, FleetLink]]:
    """Yield a fleet over its slot-0 points with the missions on board, whose links then lose this share each way."""
    flown = moving_plan(uavs=VEHICLES, slots=60)
    low = flown.model_copy(update={"scenario": flown.scenario.with_changes(altitude_m=ALTITUDE_M)})
    async with hovering(low, autopilot, speedup=SPEEDUP) as (fleet, link, ids):
        if loss > 0.0:
            bad = sim.Impairments(loss=loss)
            for system_id in ids:
                fleet.inject(sim.Impair(system_id, up=bad, down=bad))
            await asyncio.sleep(0.1)
        yield fleet, link
