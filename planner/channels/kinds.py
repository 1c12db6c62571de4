"""The kinds of channels by the name that scenarios give them: a new one is a file beside this one, and a row here."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import GetJsonSchemaHandler, SerializeAsAny, WrapValidator
from pydantic_core import CoreSchema
from pydantic_core.core_schema import ValidatorFunctionWrapHandler

from skyfolio.planner.channels.aerial_3gpp import Aerial3gpp
from skyfolio.planner.channels.los_probability import LosProbability
from skyfolio.planner.channels.radio import RadioChannel
from skyfolio.planner.channels.rician import Channel

KINDS: dict[str, type[RadioChannel]] = {
    "rician": Channel,
    "los_probability": LosProbability,
    "3gpp_uav": Aerial3gpp,
}


def channel_of(given: Any) -> RadioChannel:
    """Return the channel that a document describes, of its `kind`; without one, the letter's.

    Raises ValueError for an unknown kind, and pydantic's errors of fields for others.
    """
    if isinstance(given, RadioChannel):
        return given
    kind = given.get("kind", "rician") if isinstance(given, Mapping) else "rician"
    if not isinstance(kind, str) or kind not in KINDS:
        raise ValueError(f"kind: {kind!r} must be one of {', '.join(KINDS)}")
    return KINDS[kind].model_validate(given)


def _validated(given: Any, _: ValidatorFunctionWrapHandler) -> RadioChannel:
    return channel_of(given)


class _AnyKind:
    """Says in JSON schemas that a channel is one of the kinds."""

    @classmethod
    def __get_pydantic_json_schema__(cls, _: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        return {"anyOf": [handler(kind.__pydantic_core_schema__) for kind in KINDS.values()]}


AnyChannel = Annotated[SerializeAsAny[RadioChannel], WrapValidator(_validated), _AnyKind]
"""A field that holds a channel of any kind."""
