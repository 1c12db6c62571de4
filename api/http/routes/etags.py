"""The ETags of operations: each names the operation and the version of what can be commanded."""

from __future__ import annotations

import re
from typing import Annotated

from fastapi import Header, Response

from skyfolio.api.common.errors import InvalidError
from skyfolio.api.flights.operation_views import OperationView

IfMatch = Annotated[
    str | None,
    Header(alias="If-Match", max_length=200, description="Only if the operation still has this ETag; else 412."),
]


def tag_of(view: OperationView) -> str:
    """Return the ETag of this version of an operation."""
    return f'"{view.id}.{view.version}"'


def tagged(response: Response, view: OperationView) -> OperationView:
    """Return the view, and its ETag in the response's header."""
    response.headers["ETag"] = tag_of(view)
    return view


def version_of(if_match: str | None) -> int | None:
    """Return the version that an ETag names; None for `*` and without an ETag."""
    if if_match is None or if_match.strip() == "*":
        return None
    etag = re.fullmatch(r'\s*"?[A-Za-z0-9-]+\.([0-9]{1,9})"?\s*', if_match)
    if etag is None:
        raise InvalidError(f"If-Match: {if_match!r} is not an ETag of this service")
    return int(etag.group(1))
