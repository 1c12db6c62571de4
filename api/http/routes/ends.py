"""When an operation without a fixed end is to end, as clients say it."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated

from pydantic import AwareDatetime, Field

from skyfolio.api.common.errors import InvalidError
from skyfolio.api.flights.endless.terms import End

Duration = Annotated[
    float | None,
    Field(gt=0, le=1e8, allow_inf_nan=False, description="Fleet seconds since slot 0 at which it is to end."),
]
Until = Annotated[
    AwareDatetime | None, Field(description="The time at which it is to end, ISO 8601 with its offset from UTC.")
]


def end_of(duration_s: float | None, until: datetime | None) -> End:
    """Return the end that these two fields ask for; never, without either. Raises InvalidError for both."""
    if duration_s is not None and until is not None:
        raise InvalidError("until: give duration_s or until, not both")
    return End(duration_s=duration_s, until_utc_s=None if until is None else until.timestamp())
