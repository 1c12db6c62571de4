"""Settings put into the base of a sweep: one case, a scenario and the way to plan it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil
from typing import Any

from pydantic import ValidationError

from skyfolio.api.common.validation import broken_rules
from skyfolio.api.lab.sweep.spec import Base, Layout, Settings, Spec, SpecError
from skyfolio.planner import EXAMPLES, METHODS, Scenario, letter
from skyfolio.planner.layouts import laid_out, scattered

LAYOUT = "layout."
MOST_TRIED = 64
"""Values of each axis that are tried before a sweep begins."""
PLANNING = ("method", "starts", "seed", "failed", "at_slot")
"""Settings that are no part of the scenario."""


@dataclass(frozen=True, kw_only=True)
class Case:
    """A scenario, how it is planned, and what is lost when; at_slot None is half way."""

    scenario: Scenario
    method: str = "fast"
    starts: int | None = None
    seed: int = 0
    failed: tuple[str, ...] = ()
    at_slot: int | None = None


def case_of(base: Base, settings: Settings) -> Case:
    """Return the case of these settings. Raises SpecError that names the setting or the field of the scenario."""
    planning = {name: settings[name] for name in PLANNING if name in settings}
    scenario = scenario_of(base, {name: value for name, value in settings.items() if name not in PLANNING})
    return Case(scenario=scenario, **_checked(planning))


def check(spec: Spec) -> None:
    """Try the first case, and the values of each axis beside it. Raises SpecError for one that no case can have.

    Values that make no scenario only together with others are found when the case is planned: then its row says so.
    """
    first = {name: axis.grid()[0] for name, axis in spec.vary.items()}
    for name, axis in spec.vary.items():
        for value in axis.grid()[:: ceil(axis.count / MOST_TRIED)]:
            case_of(spec.base, {**spec.fixed, **first, name: value})
    case_of(spec.base, {**spec.fixed, **first})


def scenario_of(base: Base, settings: Settings) -> Scenario:
    """Return the base with these fields. Raises SpecError."""
    layout = {name.removeprefix(LAYOUT): value for name, value in settings.items() if name.startswith(LAYOUT)}
    fields = {name: value for name, value in settings.items() if not name.startswith(LAYOUT)}
    tree = _base_tree(base, layout)
    for name, value in fields.items():
        _put(tree, name.split("."), value, name)
    try:
        return Scenario.model_validate_json(json.dumps(tree))
    except ValidationError as error:
        raise _as_spec_error(error) from error


def _base_tree(base: Base, changed: Settings) -> Any:
    """Return the base scenario as JSON data, all its fields written out."""
    if base.layout is None:
        if changed:
            raise SpecError(f"layout.{next(iter(changed))}: the base has no layout")
        if base.scenario is None:
            return EXAMPLES[str(base.example)]().model_dump(mode="json")
        try:
            return Scenario.model_validate_json(json.dumps(base.scenario)).model_dump(mode="json")
        except ValidationError as error:
            raise _as_spec_error(error, "base.scenario.") from error
    try:
        layout = Layout(**{**base.layout.model_dump(), **changed})
    except ValidationError as error:
        raise _as_spec_error(error, LAYOUT) from error
    return _laid_out(layout).model_dump(mode="json")


def _laid_out(layout: Layout) -> Scenario:
    size = layout.uavs, layout.users, layout.slots
    if layout.kind == "letter":
        return letter(layout_seed=layout.seed, fading_seed=layout.seed)
    if layout.kind == "scattered":
        return scattered(*size, seed=layout.seed)
    return laid_out(layout.kind, *size, seed=layout.seed)


def _put(tree: Any, path: Sequence[str], value: Any, name: str) -> None:
    """Replace what is at the path: `*` is every element of a list, which may be named by number or by its `id`."""
    head, *rest = path
    if isinstance(tree, list):
        for place in _places(tree, head, name):
            if rest:
                _put(tree[place], rest, value, name)
            else:
                tree[place] = value
    elif not isinstance(tree, dict) or head not in tree:
        raise SpecError(f"{name}: a scenario has no field {head!r} there")
    elif rest:
        _put(tree[head], rest, value, name)
    else:
        tree[head] = value


def _places(elements: list[Any], head: str, name: str) -> Sequence[int]:
    if head == "*":
        return range(len(elements))
    ids = [element.get("id") if isinstance(element, dict) else None for element in elements]
    if head in ids:
        return [ids.index(head)]
    if head.isdecimal() and int(head) < len(elements):
        return [int(head)]
    raise SpecError(f"{name}: {head!r} is none of the {len(elements)} there")


def _checked(planning: Settings) -> Settings:
    method = planning.get("method", "fast")
    if method not in METHODS:
        raise SpecError(f"method: {method!r} must be one of {', '.join(METHODS)}")
    for name, least in (("starts", 1), ("seed", 0), ("at_slot", 0)):
        value = planning.get(name, least)
        if type(value) is not int or value < least:
            raise SpecError(f"{name}: {value!r} must be an integer of at least {least}")
    failed = planning.get("failed", [])
    if not isinstance(failed, list) or not all(isinstance(uav, str) for uav in failed):
        raise SpecError(f"failed: {failed!r} must be a list of UAV ids, such as [] or ['uav-1']")
    return {**planning, "failed": tuple(failed)}


def _as_spec_error(error: ValidationError, prefix: str = "") -> SpecError:
    rows = broken_rules(error.errors(), ())
    return SpecError("\n".join(f"{prefix}{row['field']}: {row['message']}" for row in rows))
