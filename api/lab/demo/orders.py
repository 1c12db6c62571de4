"""The configuration of a drill, and its outcome as the service reports it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from skyfolio.planner import EXAMPLES, Plan, Scenario, Utility


@dataclass(frozen=True, kw_only=True)
class DemoConfig:
    """How to fly it. kill_slot counts from 1, as the letter does; speedup is fleet seconds per wall second.

    The default is the letter's scenario with a utility that trades between users, so that what a loss does to each, and
    what replanning mends, is seen. Under `sum` the planner ignores users that are served by none, before the loss or
    after it.
    """

    scenario: Scenario = field(
        default_factory=lambda: EXAMPLES["paper"]().with_changes(utility=Utility(kind="pooled", mu_per_kbps=-0.3))
    )
    speedup: float = 5.0
    kill: str = "uav-2"
    kill_slot: int = 11
    replan: bool = True
    out: Path = Path("out/demo")


@dataclass(frozen=True)
class Outcome:
    """What the service reported in the end, and when slot 0 began on the simulator's clock.

    received: what users got from base stations, as `received.Received`; empty where nothing was measured.
    """

    operation: dict[str, Any]
    plans: list[Plan]
    slot0_s: float
    kill_at_s: float
    received: Sequence[tuple[float, Mapping[str, float]]] = ()
