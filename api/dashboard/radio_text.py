"""Describes events of the radio half of an operation to the operator. Pure."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

Data = Mapping[str, Any]


def _allocations(data: Data) -> tuple[str, str]:
    silent = data.get("unacknowledged") or []
    if not silent:
        return "", ""
    return f"the base stations of {', '.join(silent)} have not acknowledged what they serve", "warn"


def _reassociated(data: Data) -> tuple[str, str]:
    lost = ", ".join(data.get("lost") or ())
    if data.get("error"):
        return f"users of {lost} are not served until there is a new plan: {data.get('error')}", "alarm"
    if data.get("plan_id") is None:
        return "", ""  # a new plan was there before
    return f"users of {lost} are served by the others at once", "ok"


def _rates_off(data: Data) -> tuple[str, str]:
    return f"measured rates are {float(data.get('difference') or 0.0):.0%} off those of the plan", "warn"


RADIO_DESCRIPTIONS: Mapping[str, Callable[[Data], tuple[str, str]]] = {
    "allocations": _allocations,
    "reassociated": _reassociated,
    "rates_off": _rates_off,
}
