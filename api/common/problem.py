"""The response to an error: RFC 9457 problem+json."""

from __future__ import annotations

from pydantic import BaseModel


class Problem(BaseModel):
    """What went wrong (RFC 9457). `errors` names the broken rules, each with the field it is about."""

    type: str
    title: str
    status: int
    detail: str
    errors: list[dict[str, str]] | None = None
