"""Messages to and from a planner process. Importing this loads no solver."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

from skyfolio.planner import PlanStatus


@dataclass(frozen=True, kw_only=True)
class Job:
    """One solve, as JSON: a scenario to plan, or a previous plan to replan.

    `request`: further arguments of `planner.plan` or `planner.replan`, as pins.

    `task`: beside `plan`, which is both of these, `reassociate` lets the survivors of the previous plan serve its users
    by `request` (arguments of `planner.reassociate`), `explain` explains the previous plan with `request` (a
    `planner.Budget`), `preview` compares it with a scenario or, without one, with a replan by `request`, and `assess`
    puts it through `request` (a `planner.Trial`).
    `starts`: how many the optimiser climbs from; None lets it choose by size, a plan's then at most `most_starts`.
    """

    task: Literal["plan", "reassociate", "explain", "preview", "assess"] = "plan"
    scenario: str | None = None
    previous: str | None = None
    request: dict[str, Any] = field(default_factory=dict)
    identity: dict[str, Any] = field(default_factory=dict)
    deadline_s: float = 60.0
    starts: int | None = None
    most_starts: int = 64


@dataclass(frozen=True, kw_only=True)
class Solved:
    """What a worker returns: a plan as JSON with its status, or the reason why there is none.

    `report`: what an explanation, a preview or an assessment says, as JSON. `complete`: whether there was time for all.
    """

    status: PlanStatus
    plan: str = ""
    summary: str = ""
    iterations: int = 0
    solve_ms: float = 0.0
    error: str | None = None
    report: str = ""
    complete: bool = True
