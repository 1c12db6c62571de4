"""Methods, utilities and kinds of channels that other packages add, by name; a name is given once.

What is registered is known to this process only. A service, its workers and the command line register what installed
packages offer as entry points of the group `skyfolio.plugins` (`api/common/plugins.py`).
"""

from __future__ import annotations

from typing import Any, TypeVar, cast

from skyfolio.planner.channels.kinds import KINDS
from skyfolio.planner.channels.radio import RadioChannel
from skyfolio.planner.methods import METHODS, Method
from skyfolio.planner.utilities import UTILITIES
from skyfolio.planner.utilities.kind import Kind

AnyKindOfChannel = TypeVar("AnyKindOfChannel", bound=type[RadioChannel])


def register_channel(kind: AnyKindOfChannel) -> AnyKindOfChannel:
    """Let scenarios name this kind of channel by the default of its field `kind`; usable as a decorator.

    Raises ValueError for a class that is no channel, has no name, or has the name of another.
    """
    is_channel = isinstance(kind, type) and issubclass(kind, RadioChannel)
    field = cast("type[RadioChannel]", kind).model_fields.get("kind") if is_channel else None
    if field is None or not isinstance(field.default, str):
        raise ValueError(f"channel: {kind!r} must be a RadioChannel with a field kind: Literal['NAME'] = 'NAME'")
    _register("channel", KINDS, field.default, kind)
    return kind


def register_utility(name: str, kind: Kind) -> None:
    """Let scenarios name this utility. Raises ValueError for a name that is taken, and for what is no `Kind`."""
    if not isinstance(kind, Kind):
        raise ValueError(f"utility: {kind!r} must be a skyfolio.planner.utilities.Kind")
    _register("utility", UTILITIES, name, kind)


def register_method(name: str, method: Method) -> None:
    """Let `plan(method=...)` name this method, a callable like `Method`. Raises ValueError for a name that is taken."""
    if not callable(method):
        raise ValueError(f"method: {method!r} must be callable")
    _register("method", METHODS, name, method)


def _register(what: str, known: dict[str, Any], name: str, given: object) -> None:
    if not name.isidentifier() and not name.replace("-", "_").isidentifier():
        raise ValueError(f"{what}: {name!r} must be letters, digits, - and _, and begin with a letter")
    if known.setdefault(name, given) is not given:
        raise ValueError(f"{what}: the name {name!r} is taken")
