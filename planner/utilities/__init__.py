"""The utilities there are: one file and one row of the table for each (`docs/utilities.md` shows how to add one)."""

from typing import Annotated, Any

from pydantic import GetCoreSchemaHandler
from pydantic_core import CoreSchema, PydanticKnownError, core_schema

from skyfolio.planner.utilities.all_users import POOLED
from skyfolio.planner.utilities.each_user import PER_USER
from skyfolio.planner.utilities.kind import Expectation, Kind
from skyfolio.planner.utilities.slot_sums import SUM

__all__ = ["UTILITIES", "Expectation", "Kind", "UtilityName", "kind_of"]

UTILITIES: dict[str, Kind] = {
    "sum": SUM,
    "per_user": PER_USER,
    "pooled": POOLED,
}


def kind_of(name: str) -> Kind:
    """Return the utility of this name. Raises ValueError with the names there are."""
    if name not in UTILITIES:
        raise ValueError(f"utility.kind: {name!r} must be one of {', '.join(UTILITIES)}")
    return UTILITIES[name]


def _known(name: Any) -> str:
    if not isinstance(name, str) or name not in UTILITIES:
        *most, last = map(repr, UTILITIES)
        raise PydanticKnownError("literal_error", {"expected": f"{', '.join(most)} or {last}"})
    return name


class _OfTheTable:
    """Validates a name of the table as it is now, and says in JSON schemas which names there are."""

    @classmethod
    def __get_pydantic_core_schema__(cls, _: Any, __: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_plain_validator_function(
            _known,
            serialization=core_schema.to_string_ser_schema(),
            metadata={"pydantic_js_functions": [lambda _, __: {"enum": list(UTILITIES), "type": "string"}]},
        )


UtilityName = Annotated[str, _OfTheTable]
"""A field that holds the name of a utility."""
