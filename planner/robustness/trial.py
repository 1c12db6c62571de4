"""What a plan is put through: disturbances, losses, and what counts as an outage. Importing this loads no kernels."""

from __future__ import annotations

from itertools import combinations
from typing import Annotated

from pydantic import Field

from skyfolio.planner.plans import Plan
from skyfolio.planner.robustness.disturbances import Disturbances
from skyfolio.planner.robustness.findings import RobustnessError
from skyfolio.planner.scenario import Frozen

MOST_CELL_DRAWS = 1_000_000_000
"""Draws x UAVs x users x slots that may be asked for: some 30 s of processor time for the draws alone."""


class Losses(Frozen):
    """Which losses are tried. at_once: up to how many UAVs are lost together, 0 to 2.

    at_slots: when, on the operation's grid (default: half way). recovery_s: seconds from a loss until the new plan is
    flown: until then survivors keep to the old one. starts: of each replan. most: losses that are tried at most,
    single ones first.
    """

    at_once: Annotated[int, Field(strict=True, ge=0, le=2)] = 2
    at_slots: Annotated[tuple[Annotated[int, Field(strict=True, ge=0)], ...], Field(max_length=16)] = ()
    recovery_s: Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0, le=600)] = 8.0
    starts: Annotated[int, Field(strict=True, ge=1, le=64)] = 4
    most: Annotated[int, Field(strict=True, ge=0, le=10_000)] = 200


class Trial(Frozen):
    """All of it. outage_bps: a user that gets less in a slot is in outage.

    Without it, one that gets less than its `min_rate_bps`, or where it has none, less than `outage_share` of what the
    plan gives it in that slot.
    """

    disturbances: Disturbances = Disturbances()
    losses: Losses = Losses()
    outage_share: Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0, le=1)] = 0.5
    outage_bps: Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0, le=1e15)] | None = None

    @property
    def outage(self) -> str:
        """Return what an outage is, in words."""
        if self.outage_bps is not None:
            return f"less than {self.outage_bps:g} bit/s in a slot"
        share = f"{self.outage_share:.0%} of what is planned in that slot"
        return f"less than its min_rate_bps in a slot; without one, less than {share}"


def require_possible(plan: Plan, trial: Trial) -> None:
    """Check that a plan can be put through this. Raises RobustnessError that names the field."""
    asked_losses(plan, trial.losses)
    cells = len(plan.scenario.uavs) * len(plan.scenario.users) * plan.scenario.slots
    if trial.disturbances.draws * cells > MOST_CELL_DRAWS:
        raise RobustnessError(
            f"disturbances.draws: {trial.disturbances.draws} draws of {cells} cells (UAVs x users x slots) are too "
            f"many; at most {max(1, MOST_CELL_DRAWS // cells)}"
        )


def asked_losses(plan: Plan, losses: Losses) -> list[tuple[tuple[str, ...], int]]:
    """Return (lost UAVs, slot on the plan's own grid) of every loss that is asked for. Raises RobustnessError."""
    scenario, first = plan.scenario, plan.first_slot
    slots = losses.at_slots or (first + scenario.slots // 2,)
    for slot in slots:
        if not 0 <= slot - first < scenario.slots:
            raise RobustnessError(f"losses.at_slots: {slot} must lie in {first}..{first + scenario.slots - 1}")
    asked = []
    for together in range(1, losses.at_once + 1):
        for slot in dict.fromkeys(slots):
            flying = [uav.id for uav in scenario.uavs if scenario.last_slot(uav) >= slot - first]
            asked += [(lost, slot - first) for lost in combinations(flying, together)]
    return asked
