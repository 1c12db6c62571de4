"""What every operation of the service uses, beside its vehicles and its stores."""

from __future__ import annotations

from dataclasses import dataclass

from skyfolio.api.common.fleet_clock import FleetClock
from skyfolio.api.common.metrics import Metrics
from skyfolio.api.common.settings import Settings
from skyfolio.api.plans.contingencies import Contingencies
from skyfolio.api.plans.plan_book import PlanBook


@dataclass(frozen=True)
class SharedServices:
    """The parts of the service that operations share."""

    settings: Settings
    clock: FleetClock
    plans: PlanBook
    contingencies: Contingencies
    metrics: Metrics
