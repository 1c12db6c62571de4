"""What `skyfolio bound` proves in a minute of processor time, layout by layout."""

from __future__ import annotations

import time
from typing import Any

from skyfolio.api.lab.bench.effort import Effort
from skyfolio.api.lab.bench.instances import Size
from skyfolio.api.lab.bench.quality import described
from skyfolio.api.plans.certificate import certify
from skyfolio.planner.rehearsal import rehearse

TOLERANCE = 0.005


def bound(size: Size, kind: str, effort: Effort) -> dict[str, Any]:
    """Measure the gap that is proven of a default plan, with the plan and after proving on."""
    rehearse()
    rows = []
    for instance in effort.proven(size, kind):
        proven = certify(instance.scenario(), tolerance=TOLERANCE, seconds=effort.bound_s, clock=time.process_time)
        kept = ("utility_bps", "root_gap", "upper_bound_bps", "gap", "finished", "seconds")
        rows.append({**described(instance), **{key: proven[key] for key in kept}})
    return {"seconds_each": effort.bound_s, "instances": rows}
