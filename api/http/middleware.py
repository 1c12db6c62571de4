"""The middleware around every request: id, host and origin, API key, rate and body limits; log, metrics, audit.

It is plain ASGI, so that it covers mounted apps, streams and websockets alike.
"""

from __future__ import annotations

import asyncio
import re
import secrets
import time
from http.cookies import CookieError, SimpleCookie

import structlog
from fastapi import FastAPI
from starlette.datastructures import Headers, MutableHeaders
from starlette.exceptions import HTTPException
from starlette.responses import RedirectResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from skyfolio.api.access.api_keys import LOCAL, RECHECK_S, Principal
from skyfolio.api.common.errors import (
    ProxiedError,
    ServiceError,
    TooLargeError,
    TooManyRequestsError,
    UnauthorizedError,
)
from skyfolio.api.dashboard import port
from skyfolio.api.http import response_headers as edge
from skyfolio.api.http.origin_checks import AllowedHosts, require_json, require_same_origin
from skyfolio.api.http.problems import answer_to
from skyfolio.api.http.proxies import inner_path
from skyfolio.api.service import Service
from skyfolio.api.store import StoreError

log = structlog.get_logger()
OPEN_PATHS = frozenset({"/health", "/ready", "/docs", "/openapi.json", "/login"})
OPEN_BELOW = "/docs/assets/"
SAFE = frozenset({"GET", "HEAD", "OPTIONS"})
BODY_LIMIT_S = 30.0
"""Wall seconds in which a body must have arrived."""
MOST_BUCKETS = 10_000
_ID = re.compile(r"[A-Za-z0-9._-]{1,64}")


class TokenBuckets:
    """A token bucket for each client: `rate_per_s` on average, `burst` at once."""

    def __init__(self, rate_per_s: float, burst: int) -> None:
        self._rate, self._burst = rate_per_s, burst
        self._state: dict[str, tuple[float, float]] = {}

    def take(self, client: str, now_s: float) -> bool:
        """Take a token of the client. Return whether there was one; `now_s` is monotonic."""
        tokens, at_s = self._state.pop(client, (float(self._burst), now_s))
        tokens = min(self._burst, tokens + (now_s - at_s) * self._rate)
        if len(self._state) >= MOST_BUCKETS:  # forget the client that has been silent for longest
            del self._state[next(iter(self._state))]
        self._state[client] = (tokens - 1 if tokens >= 1 else tokens, now_s)
        return tokens >= 1


class AdmissionMiddleware:
    """ASGI middleware around the whole application."""

    def __init__(self, app: ASGIApp, *, owner: FastAPI) -> None:
        self._app, self._owner = app, owner
        self._buckets: TokenBuckets | None = None
        self._hosts: AllowedHosts | None = None

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass one request or websocket through."""
        if scope["type"] not in {"http", "websocket"}:
            await self._app(scope, receive, send)
            return
        await self._pass(RequestAdmission(self._owner.state.service, scope), scope, receive, send)

    async def _pass(self, admission: RequestAdmission, scope: Scope, receive: Receive, send: Send) -> None:
        with structlog.contextvars.bound_contextvars(request_id=admission.request_id):
            try:
                admission.principal = await self._admit(admission)
                state = scope.setdefault("state", {})
                state["principal"], state["still_admitted"] = admission.principal, admission.still_admitted
                take = (
                    admission.limited(receive) if scope["type"] == "http" else admission.while_admitted(receive, send)
                )
                await self._app(scope, take, admission.noting(send))
            except (ServiceError, StoreError) as error:  # raised before any route was reached
                if isinstance(error, UnauthorizedError) and admission.wants_page:
                    await RedirectResponse("/login", 303)(scope, receive, admission.noting(send))
                elif scope["type"] == "websocket":
                    await send({"type": "websocket.close", "code": 1008, "reason": str(error)[:100]})
                else:
                    await answer_to(error)(scope, receive, admission.noting(send))
            finally:
                admission.finish()

    async def _admit(self, admission: RequestAdmission) -> Principal:
        service = admission.service
        if self._buckets is None or self._hosts is None:
            self._buckets = TokenBuckets(service.settings.rate_per_s, service.settings.rate_burst)
            self._hosts = AllowedHosts(service.settings)
        if not self._buckets.take(admission.client, time.monotonic()):
            raise TooManyRequestsError(f"rate: more than {service.settings.rate_per_s:g} requests a second")
        admission.require_ours(self._hosts)
        admission.require_small()
        principal = await admission.identified()
        if principal is None:
            raise UnauthorizedError("Authorization: send 'Bearer <key>' with a key made by 'skyfolio keys create'")
        return principal


class RequestAdmission:
    """The admission of one request, and what is recorded of it."""

    def __init__(self, service: Service, scope: Scope) -> None:
        self.service, self.scope = service, scope
        self.headers = Headers(scope=scope)
        self.path = inner_path(scope)
        self.method: str = scope.get("method", "WEBSOCKET")
        self.client = "inside" if scope.get(port.INSIDE) else (scope.get("client") or ("unknown", 0))[0]
        request_id = self.headers.get("x-request-id", "")
        self.request_id = request_id if _ID.fullmatch(request_id) else secrets.token_hex(8)
        self.principal: Principal | None = None
        self.status = 0
        self._began = time.monotonic()
        self._received = 0
        self._over = False

    @property
    def key(self) -> str | None:
        """Return the API key: from `Authorization: Bearer`, `X-API-Key`, or the cookie of the web page."""
        scheme, _, token = self.headers.get("authorization", "").partition(" ")
        if scheme.lower() == "bearer" and token:
            return token.strip()
        if "x-api-key" in self.headers:
            return self.headers["x-api-key"]
        try:
            cookie = SimpleCookie(self.headers.get("cookie", "")).get(port.COOKIE)
        except CookieError:
            return None
        return cookie.value if cookie else None

    @property
    def wants_page(self) -> bool:
        """Return whether a person's browser asks for a page of the dashboard."""
        page = self.path == "/" or self.of_dashboard
        return self.method == "GET" and page and "text/html" in self.headers.get("accept", "")

    @property
    def of_dashboard(self) -> bool:
        """Return whether the request is for the dashboard, which has a framework and a protocol of its own."""
        return self.path == port.PATH or self.path.startswith(f"{port.PATH}/")

    def require_ours(self, hosts: AllowedHosts) -> None:
        """Refuse what a browser may have been made to send.

        Raises MisdirectedError, CrossSiteError or MediaTypeError.
        """
        host = hosts.require(self.headers)
        require_same_origin(self.headers, host, safe=self.method in SAFE)
        if self.method not in SAFE | {"WEBSOCKET"} and not self.of_dashboard:
            require_json(self.headers)

    async def identified(self) -> Principal | None:
        """Return who asks, None without the key that is needed. Raises ProxiedError and TooManyRequestsError."""
        if await self._is_open():
            return LOCAL
        if self.key is None or self.scope.get(port.INSIDE):
            return await self._known()
        return await self.service.authenticator.identify(self.client, self.key)

    async def _known(self) -> Principal | None:
        return await self.service.keys.identify(self.key) if self.key else None

    async def _is_open(self) -> bool:
        """Return whether no key is needed. Raises ProxiedError: behind a proxy every client looks local."""
        if self.path in OPEN_PATHS or self.path.startswith(OPEN_BELOW):
            return True
        if not self.service.settings.on_loopback or await self.service.keys.in_use():
            return False
        if self.scope.get("state", {}).get("proxied"):
            raise ProxiedError(
                "X-Forwarded-For: the request came through a proxy and there is no API key; make one with "
                "'skyfolio keys create NAME --role pilot'"
            )
        return True

    async def still_admitted(self) -> bool:
        """Return whether the request would still be admitted now, with the same rights."""
        try:
            return (LOCAL if await self._is_open() else await self._known()) == self.principal
        except StoreError:  # a database that does not answer revokes nothing
            return True

    def while_admitted(self, receive: Receive, send: Send) -> Receive:
        """Return the receive channel of a websocket, which ends when its key is revoked."""
        asked_s = time.monotonic()

        async def revoked() -> bool:
            nonlocal asked_s
            if time.monotonic() - asked_s < RECHECK_S:
                return False
            asked_s = time.monotonic()
            return not await self.still_admitted()

        async def take() -> Message:
            message = asyncio.ensure_future(receive())
            try:
                while not message.done():
                    await asyncio.wait({message}, timeout=RECHECK_S)
                    if await revoked():
                        self._over = True
                        await send({"type": "websocket.close", "code": 1008, "reason": "the API key was revoked"})
                        return {"type": "websocket.disconnect", "code": 1008}
                return message.result()
            finally:
                message.cancel()

        return take

    def require_small(self) -> None:
        """Refuse a body whose declared length is too large. Raises TooLargeError."""
        length = self.headers.get("content-length", "0")
        if length.isdigit() and int(length[:20]) > self.service.settings.max_body_bytes:
            raise TooLargeError(f"body: {length[:20]} bytes are more than {self.service.settings.max_body_bytes}")

    def limited(self, receive: Receive) -> Receive:
        """Return the receive channel with the body's size and time limited."""
        until = self._began + BODY_LIMIT_S
        complete = False

        async def take() -> Message:
            nonlocal complete
            if complete:
                return await receive()
            try:
                async with asyncio.timeout(max(0.0, until - time.monotonic())):
                    message = await receive()
            except TimeoutError:
                raise HTTPException(408, f"body: did not arrive within {BODY_LIMIT_S:g} s") from None
            self._received += len(message.get("body", b""))
            complete = not message.get("more_body", False)
            if self._received > self.service.settings.max_body_bytes:
                raise HTTPException(413, f"body: more than {self.service.settings.max_body_bytes} bytes")
            return message

        return take

    def noting(self, send: Send) -> Send:
        """Return the send channel, which notes the status and adds the headers that every response carries."""

        async def give(message: Message) -> None:
            if self._over:
                return
            if message["type"] == "http.response.start":
                self.status = message["status"]
                headers = MutableHeaders(raw=list(message["headers"]))
                policy = edge.dashboard_policy(self.service.settings.tile_url) if self.of_dashboard else None
                edge.add(headers, dashboard=policy, request_id=self.request_id)
                message = {**message, "headers": headers.raw}
            await send(message)

        return give

    def finish(self) -> None:
        """Log and measure the request, and write it to the audit log."""
        seconds = time.monotonic() - self._began
        if self.status == 0:
            return
        route = getattr(self.scope.get("route"), "path", "none")
        self.service.metrics.requests.labels(self.method, route, str(self.status)).observe(seconds)
        request = {"method": self.method, "path": self.path, "status": self.status, "ms": round(seconds * 1e3, 1)}
        if self.method in SAFE and self.status < 400:
            return
        principal = self.principal or Principal("nobody", LOCAL.role)
        log.info("request", principal=principal.name, **request)
        row = {
            "at": time.time(),
            "principal": principal.name,
            "role": principal.role.value if self.principal else "none",
            "client": str(self.client)[:64],
            "method": self.method[:8],
            "path": self.path[:256].replace("\0", "?"),
            "status": self.status,
            "request_id": self.request_id,
        }
        if self.method not in SAFE or self.status in {401, 403}:
            self.service.audit.write(row)
