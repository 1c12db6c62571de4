"""Plans with wind and batteries beside the same ones in still air: what they take, and that both bind."""

from __future__ import annotations

from typing import Any

import numpy as np

from skyfolio.api.lab.bench.calls import timed_calls
from skyfolio.api.lab.bench.cases import instance
from skyfolio.api.lab.bench.effort import Effort
from skyfolio.api.lab.bench.instances import Size
from skyfolio.planner import Scenario
from skyfolio.planner.scenario import Battery, Wind

WIND = Wind(east_mps=3.0, north_mps=2.0, gust_mps=1.0)
MAX_AIRSPEED_MPS = 8.0
SPARE_SHARE = 0.02
"""Batteries hold this much more than staying at the start takes: a UAV that flies far has to turn back."""


def windy(scenario: Scenario) -> Scenario:
    """Return the scenario in wind, which the UAVs hardly fly against."""
    uavs = tuple(uav.model_copy(update={"max_airspeed_mps": MAX_AIRSPEED_MPS}) for uav in scenario.uavs)
    return scenario.with_changes(uavs=uavs, wind=WIND)


def short_of_energy(scenario: Scenario) -> Scenario:
    """Return the windy scenario with batteries that barely suffice."""
    ample = {"battery": Battery(usable_wh=1e5, reserve_share=0.2)}
    air = scenario.with_changes(uavs=tuple(uav.model_copy(update=ample) for uav in scenario.uavs)).air
    assert air is not None  # noqa: S101 - there are batteries
    starts = np.array([[uav.start_m] for uav in scenario.uavs], dtype=float)
    slots = np.array([scenario.last_slot(uav) + 1 for uav in scenario.uavs])
    needed = air.before_wh + air.hover_wh() * slots + air.home_wh(starts)[:, 0]
    usable = needed * (1.0 + SPARE_SHARE) / 0.8
    return scenario.with_changes(
        uavs=tuple(
            uav.model_copy(update={"battery": Battery(usable_wh=float(wh), reserve_share=0.2)})
            for uav, wh in zip(scenario.uavs, usable, strict=True)
        )
    )


def energy(size: Size, kind: str, effort: Effort) -> dict[str, Any]:
    """Measure `planner.plan` and `planner.replan` at their defaults: in still air, in wind, and short of energy too."""
    still = instance(size, kind)
    figures = {
        name: _measured(scenario, effort)
        for name, scenario in (("still", still), ("wind", windy(still)), ("energy", short_of_energy(windy(still))))
    }
    for name in ("wind", "energy"):
        for call in ("plan_call", "replan_call"):
            figures[name][call]["ratio"] = figures[name][call]["cpu_p50_ms"] / figures["still"][call]["cpu_p50_ms"]
    return figures


def _measured(scenario: Scenario, effort: Effort) -> dict[str, Any]:
    """Return the times of a plan and a replan after a loss half-way, what the plan is worth, and its least margin."""
    figures, made = timed_calls(scenario, effort)
    return figures | {"least_margin_wh": min((min(row) for row in made.energy_margin_wh.values()), default=None)}
