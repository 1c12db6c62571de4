"""The kinds of channels by the name that scenarios give them: a new one is a file beside this one, and a row here."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler, ValidationError
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, PydanticCustomError, core_schema
from pydantic_core.core_schema import ValidatorFunctionWrapHandler

from skyfolio.planner.channels.aerial_3gpp import Aerial3gpp
from skyfolio.planner.channels.gain_map import GainMap
from skyfolio.planner.channels.los_probability import LosProbability
from skyfolio.planner.channels.radio import RadioChannel
from skyfolio.planner.channels.rician import Channel

KINDS: dict[str, type[RadioChannel]] = {
    "rician": Channel,
    "los_probability": LosProbability,
    "3gpp_uav": Aerial3gpp,
    "map": GainMap,
}


def channel_of(given: Any) -> RadioChannel:
    """Return the channel that a document describes, of its `kind`; without one, the letter's.

    Raises pydantic's error of fields.
    """
    if isinstance(given, RadioChannel):
        return given
    kind = given.get("kind", "rician") if isinstance(given, Mapping) else "rician"
    if not isinstance(kind, str) or kind not in KINDS:
        unknown = PydanticCustomError(
            "unknown_kind", "There is no such kind of channel; there are {known}", {"known": ", ".join(KINDS)}
        )
        raise ValidationError.from_exception_data("Channel", [{"type": unknown, "loc": ("kind",), "input": kind}])
    return KINDS[kind].model_validate(given)


def _validated(given: Any, _: ValidatorFunctionWrapHandler) -> RadioChannel:
    return channel_of(given)


class _AnyKind:
    """Validates and writes a channel as its own kind, and says in JSON schemas which kinds there are."""

    @classmethod
    def __get_pydantic_core_schema__(cls, _: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        kinds = core_schema.union_schema([handler.generate_schema(kind) for kind in KINDS.values()])

        def described(_: Any, describe: GetJsonSchemaHandler) -> JsonSchemaValue:
            return describe(core_schema.union_schema([kind.__pydantic_core_schema__ for kind in KINDS.values()]))

        return core_schema.no_info_wrap_validator_function(
            _validated,
            kinds,
            serialization=core_schema.wrap_serializer_function_ser_schema(
                lambda channel, write: write(channel), schema=core_schema.any_schema()
            ),
            metadata={"pydantic_js_functions": [described]},
        )


AnyChannel = Annotated[RadioChannel, _AnyKind]
"""A field that holds a channel of any kind."""
