"""How requests of the client travel: one HTTP client, the key, and errors as exceptions."""

from __future__ import annotations

import json
from collections.abc import Iterator
from types import TracebackType
from typing import Any, Self, TypeVar

import httpx2
from pydantic import BaseModel

from skyfolio.api.common.errors import ServiceError
from skyfolio.api.common.problem import Problem

Model = TypeVar("Model", bound=BaseModel)
PAGE = 100


class ApiError(ServiceError):
    """The service refused the request; `problem` holds its response."""

    def __init__(self, method: str, path: str, problem: Problem) -> None:
        super().__init__(f"{method} {path}: {problem.status} {problem.detail}")
        self.problem = problem

    @property
    def status(self) -> int:
        """Return the HTTP status."""
        return self.problem.status


class Transport:
    """The connection to one service. `key` is an API key; `http` replaces the HTTP client (tests pass Starlette's)."""

    def __init__(
        self,
        base_url: str = "http://127.0.0.1:8080",
        *,
        key: str | None = None,
        timeout_s: float = 70.0,
        http: httpx2.Client | None = None,
    ) -> None:
        self._http = http or httpx2.Client(base_url=base_url, timeout=timeout_s)
        self.headers = {"Authorization": f"Bearer {key}"} if key else {}

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the connections."""
        self._http.close()

    def call(self, method: str, path: str, *, key: str | None = None, **options: Any) -> httpx2.Response:
        """Send a request and return the answer; `key` makes it safe to send again. Raises ApiError."""
        headers = {**self.headers, **options.pop("headers", {})}
        if key is not None:
            headers["Idempotency-Key"] = key
        answer = self._http.request(method, path, headers=headers, **options)
        raise_for(answer, method, path)
        return answer

    def pages(self, path: str, row: type[Model]) -> Iterator[Model]:
        """Yield the rows of all pages of a list."""
        cursor: int | None = None
        while True:
            params = {"limit": PAGE} | ({} if cursor is None else {"cursor": cursor})
            page = self.call("GET", path, params=params).json()
            yield from (row.model_validate(item) for item in page["items"])
            cursor = page["next"]
            if cursor is None:
                return


def raise_for(answer: httpx2.Response, method: str, path: str) -> None:
    """Raise ApiError with the problem of an answer that is an error."""
    if answer.status_code < 400:
        return
    try:
        problem = Problem.model_validate(answer.json())
    except (json.JSONDecodeError, ValueError):
        problem = Problem(type="unknown", title="Error", status=answer.status_code, detail=answer.text[:500])
    raise ApiError(method, path, problem)
