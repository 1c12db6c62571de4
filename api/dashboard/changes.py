"""What a replan changes of the plan before, and which pins it keeps, in words. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from skyfolio.planner import Plan

Json = Mapping[str, Any]


def disruption_words(made: Json | None) -> str:
    """Return what is changed: users that change server, metres, and the price if there is one; empty if unknown."""
    if made is None:
        return ""
    users = int(made["users_changed"])
    changed = "no user changes" if users == 0 else "1 user changes" if users == 1 else f"{users} users change"
    price = f"; priced {made['price_bps'] / 1e3:.2f} kbit/s" if made["weight_kbps"] else ""
    return f"{changed} server, UAVs fly {made['path_changed_m']:.0f} m off their old paths{price}"


def pins_words(pins: Json | None, name: str = "Pins kept") -> list[str]:
    """Return which pins are kept, after this name, and each one that is dropped with its reason."""
    if pins is None:
        return []
    kept = [*pins["uavs"], *pins["users"]]
    lines = [f"{name}: {', '.join(kept)}"] if kept else []
    return [*lines, *(f"Pin of {pin['id']} dropped: {pin['reason']}" for pin in pins["dropped"])]


def of_report(report: Json, name: str = "Pins kept") -> tuple[str, ...]:
    """Return the lines that a recovery's report gives."""
    words = disruption_words(report.get("disruption"))
    return (*([words[0].upper() + words[1:]] if words else []), *pins_words(report.get("pins"), name))


def of_plan(plan: Plan) -> tuple[str, ...]:
    """Return the same lines for a plan itself."""
    kept = {"uavs": plan.pins.pinned_uavs, "users": plan.pins.associations}
    dropped = [pin.model_dump() for pin in plan.dropped_pins]
    return of_report(
        {
            "disruption": None if plan.disruption is None else plan.disruption.model_dump(),
            "pins": {**kept, "dropped": dropped},
        },
        "Pins kept" if plan.parent else "Pinned",
    )
