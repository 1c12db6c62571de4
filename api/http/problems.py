"""The one table of errors: each exception of the service and its response (RFC 9457 problem+json)."""

from __future__ import annotations

from collections.abc import Mapping
from math import ceil
from typing import Any

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from pydantic import ValidationError
from starlette.exceptions import HTTPException

from skyfolio.api.common.errors import (
    BusyError,
    ConflictError,
    CrossSiteError,
    ForbiddenError,
    InvalidError,
    MediaTypeError,
    MisdirectedError,
    NotFoundError,
    PreconditionError,
    ProxiedError,
    TooLargeError,
    TooManyRequestsError,
    UnauthorizedError,
)
from skyfolio.api.common.problem import Problem
from skyfolio.api.common.validation import broken_rules
from skyfolio.api.store.errors import StoreError
from skyfolio.mavlink_bridge import BridgeError
from skyfolio.planner import InfeasiblePlanError, PinError, ReplanError, RobustnessError

TABLE: Mapping[type[Exception], tuple[int, str, str]] = {
    NotFoundError: (404, "not-found", "Not found"),
    ConflictError: (409, "conflict", "Not possible in this state"),
    InvalidError: (422, "invalid-request", "The request breaks a rule"),
    ReplanError: (422, "invalid-request", "The request breaks a rule"),
    PinError: (422, "invalid-request", "The request breaks a rule"),
    RobustnessError: (422, "invalid-request", "The request breaks a rule"),
    BusyError: (503, "busy", "The queue is full"),
    PreconditionError: (412, "precondition", "The resource has changed"),
    UnauthorizedError: (401, "unauthorized", "An API key is needed"),
    ForbiddenError: (403, "forbidden", "The role does not allow this"),
    CrossSiteError: (403, "cross-site", "Only pages of this service may send requests to it"),
    ProxiedError: (403, "proxied", "Behind a proxy an API key is needed"),
    MediaTypeError: (415, "media-type", "Bodies are JSON"),
    MisdirectedError: (421, "host", "The host is not one of this service"),
    TooManyRequestsError: (429, "rate-limit", "Too many requests"),
    TooLargeError: (413, "too-large", "The body is too large"),
    StoreError: (503, "store", "The database does not answer"),
    InfeasiblePlanError: (500, "internal", "The planner refused its own result"),
    BridgeError: (502, "fleet", "The fleet did not carry out the order"),
}


def _described(description: str) -> dict[str, Any]:
    return {
        "description": description,
        "content": {"application/problem+json": {"schema": Problem.model_json_schema()}},
    }


DESCRIBED: dict[int | str, dict[str, Any]] = {
    status: _described(description)
    for status, description in {
        400: "The body cannot be read.",
        401: "An API key is needed.",
        403: "The key's role does not allow this, or the request comes from a page of another origin.",
        404: "There is no such resource.",
        409: "The resource is in a state that does not allow this.",
        412: "The resource is not in the version that `If-Match` names.",
        413: "The body is too large.",
        415: "The body is not `application/json`.",
        421: "The `Host` is not one of this service (setting `allowed_hosts`).",
        422: "The request breaks a rule; `errors` says which.",
        429: "More requests, or wrong API keys, than the limit allows; see `Retry-After`.",
        502: "The fleet did not carry out the order.",
        503: "The queue is full, or the database does not answer; see `Retry-After`.",
    }.items()
}
"""The error responses of every operation in the OpenAPI description."""


def problem(
    status: int,
    kind: str,
    title: str,
    detail: str,
    errors: list[dict[str, str]] | None = None,
    retry_after_s: float = 1.0,
) -> JSONResponse:
    """Return one problem+json response."""
    body: dict[str, Any] = {
        "type": f"urn:skyfolio:problem:{kind}",
        "title": title,
        "status": status,
        "detail": detail,
    }
    if errors is not None:
        body["errors"] = errors
    headers = {"Retry-After": str(max(1, ceil(retry_after_s)))} if status in {429, 503} else {}
    if status == 401:
        headers["WWW-Authenticate"] = 'Bearer realm="skyfolio"'
    return JSONResponse(body, status_code=status, media_type="application/problem+json", headers=headers)


def _invalid(errors: list[dict[str, str]]) -> JSONResponse:
    detail = "; ".join(f"{row['field']}: {row['message']}" for row in errors[:5])
    return problem(422, "invalid-request", "The request breaks a rule", detail, errors)


def answer_to(error: Exception) -> JSONResponse:
    """Return the response to an error of the table."""
    status, kind, title = next(row for cls, row in TABLE.items() if isinstance(error, cls))
    field, colon, message = str(error).partition(": ")
    errors = [{"field": field, "rule": kind, "message": message}] if status == 422 and colon else None
    errors = getattr(error, "rows", errors)
    return problem(status, kind, title, str(error), errors, getattr(error, "retry_after_s", 1.0))


def install(app: FastAPI) -> None:
    """Register the handlers of the table's errors with the app."""

    async def known(_: Request, error: Exception) -> JSONResponse:
        return answer_to(error)

    async def malformed(_: Request, error: Exception) -> JSONResponse:
        assert isinstance(error, RequestValidationError | ValidationError)  # noqa: S101 - for the type checker
        return _invalid(broken_rules(error.errors(), ("body", "query", "path", "header")))

    async def http(_: Request, error: Exception) -> JSONResponse:
        assert isinstance(error, HTTPException)  # noqa: S101 - for the type checker
        return problem(error.status_code, "http", "Request refused", str(error.detail))

    for cls in TABLE:
        app.add_exception_handler(cls, known)
    app.add_exception_handler(RequestValidationError, malformed)
    app.add_exception_handler(HTTPException, http)
