"""Handling of reverse proxies: the real client, the host it asked for, and the sub-path of the service.

`X-Forwarded-*` headers are believed from the proxies that the settings name, from no one else. Inside, paths are those
of the service; the sub-path is ASGI's `root_path`, and is put before every `Location` on the way out.
"""

from __future__ import annotations

import ipaddress
import re

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from uvicorn.middleware.proxy_headers import ProxyHeadersMiddleware

from skyfolio.api.common.settings import SUB_PATH, Settings, listed

FORWARDED = ("forwarded", "x-forwarded-for", "x-forwarded-host", "x-forwarded-prefix", "x-forwarded-proto", "x-real-ip")
"""Headers that only a proxy adds."""
_PREFIX = re.compile(SUB_PATH)


class ForwardedHeadersMiddleware:
    """ASGI middleware, outermost: afterwards `scope` is what it would be without a proxy.

    Whether there was one is kept in `scope["state"]["proxied"]`.
    """

    def __init__(self, app: ASGIApp, *, settings: Settings) -> None:
        trusted = listed(settings.trusted_proxies)
        self._app: ASGIApp = ProxyHeadersMiddleware(app, trusted)  # type: ignore[arg-type,assignment]
        self._networks = [ipaddress.ip_network(network, strict=False) for network in trusted]
        self._root_path = settings.root_path

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass one request or websocket through."""
        if scope["type"] not in {"http", "websocket"}:
            await self._app(scope, receive, send)
            return
        received = Headers(scope=scope)
        scope.setdefault("state", {})["proxied"] = any(name in received for name in FORWARDED)
        trusted = self._trusts((scope.get("client") or ("", 0))[0])
        prefix = _prefix(received) if trusted else None
        _set_root(scope, self._root_path if prefix is None else prefix)
        headers = MutableHeaders(scope=scope)
        if trusted and "x-forwarded-host" in received:
            headers["host"] = received["x-forwarded-host"].split(",")[0].strip()
        del headers["x-forwarded-prefix"]  # the dashboard's framework would believe it from anyone
        await self._app(scope, receive, _prefixing(scope["root_path"], send))

    def _trusts(self, address: str) -> bool:
        try:
            asks = ipaddress.ip_address(address)
        except ValueError:
            return False
        return any(asks in network for network in self._networks)


def inner_path(scope: Scope) -> str:
    """Return the path within the service, without the sub-path."""
    path: str = scope["path"]
    return path.removeprefix(scope.get("root_path", "")) or "/"


def _prefix(headers: Headers) -> str | None:
    """Return the sub-path that a proxy names, None when it names none or an invalid one."""
    prefix = headers.get("x-forwarded-prefix", "").rstrip("/")
    return prefix if prefix and _PREFIX.fullmatch(prefix) else None


def _set_root(scope: Scope, prefix: str) -> None:
    """Set `root_path` and `path` as ASGI has them, whether or not the proxy has removed the sub-path."""
    path: str = scope["path"]
    if prefix and path != prefix and not path.startswith(f"{prefix}/"):
        scope["path"] = prefix + path
        scope["raw_path"] = prefix.encode() + scope.get("raw_path", path.encode())
    scope["root_path"] = prefix


def _prefixing(prefix: str, send: Send) -> Send:
    """Return the send channel, which puts the sub-path before a `Location` that is a path of the service."""
    if not prefix:
        return send

    async def give(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = MutableHeaders(raw=list(message.get("headers", [])))
            location = headers.get("location", "")
            if location.startswith("/") and not location.startswith("//"):
                headers["location"] = prefix + location
            message = {**message, "headers": headers.raw}
        await send(message)

    return give
