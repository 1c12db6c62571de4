"""Validation errors, each with its field, in the same form for REST and the command line."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

_CONSEQUENCES = frozenset({"too_short", "too_long"})
"""Pydantic counts only the valid items of a list, so an invalid one breaks the rule about its length too."""
SECRETS = frozenset({"secret"})
"""Fields whose values are never said again, not even when they break a rule."""
_NO_OBJECT = frozenset({"model_attributes_type", "model_type", "dict_type"})
_UNIT_M, _UNIT_DEG = "_m", "_deg"


def broken_rules(errors: Iterable[Mapping[str, Any]], prefix: tuple[str, ...] = ("body",)) -> list[dict[str, str]]:
    """Return pydantic's errors as {field, rule, message, value}; the field is a dotted path into the request.

    A list that is too short only because an item of it is invalid is reported by the item's own error alone, and metres
    that are missing only because their twin in degrees is invalid by the twin's.
    """
    all_errors = list(errors)
    return [_row(error, prefix) for error in all_errors if not _is_consequence(error, all_errors)]


def _is_consequence(error: Mapping[str, Any], errors: list[Mapping[str, Any]]) -> bool:
    loc = tuple(error["loc"])
    if error["type"] == "missing" and loc:
        return any(_could_not_be_converted(loc, tuple(other["loc"])) for other in errors)
    return error["type"] in _CONSEQUENCES and any(
        len(other["loc"]) > len(loc) and tuple(other["loc"][: len(loc)]) == loc for other in errors
    )


def _could_not_be_converted(missing: tuple[Any, ...], other: tuple[Any, ...]) -> bool:
    """Return whether the missing field would have been found from degrees that break a rule of their own."""
    *part, name = missing
    if name == "origin":
        return any(str(step).endswith(_UNIT_DEG) for step in other)
    twin = f"{str(name).removesuffix(_UNIT_M)}{_UNIT_DEG}"
    return str(name).endswith(_UNIT_M) and other[: len(missing)] == (*part, twin)


def _row(error: Mapping[str, Any], prefix: tuple[str, ...]) -> dict[str, str]:
    loc = [str(part) for part in error["loc"]]
    loc = loc[1:] if loc and loc[0] in prefix else loc
    message = str(error["msg"]).removeprefix("Value error, ")
    if error["type"] in _NO_OBJECT:  # pydantic speaks of Python's dictionaries
        message = "Input should be a JSON object"
    if not loc and ": " in message:  # a rule across fields names its field itself
        field, message = message.split(": ", 1)
        loc = [field]
    row = {"field": ".".join(loc) or "body", "rule": str(error["type"]), "message": message}
    value = error.get("input")
    if loc and loc[-1] in SECRETS:
        return row
    if isinstance(value, str | int | float | bool) or value is None:
        row["value"] = repr(value)[:100]
        if error["type"] == "string_pattern_mismatch":
            row["message"] = f"{row['value']}: {message}"
    return row
