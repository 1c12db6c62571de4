"""Behind a reverse proxy: who really asks, under which host, and below which sub-path.

What `X-Forwarded-*` say is believed of the proxies that the settings name, of nobody else. Inside, paths are those of
the service; the sub-path is ASGI's `root_path`, and is put before every `Location` on the way out.
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


class Proxied:
    """ASGI middleware, outermost: `scope` says afterwards what it would say without a proxy.

    Whether there was one is kept in `scope["state"]["proxied"]`.
    """

    def __init__(self, app: ASGIApp, *, settings: Settings) -> None:
        trusted = listed(settings.trusted_proxies)
        self._app: ASGIApp = ProxyHeadersMiddleware(app, trusted)  # type: ignore[arg-type,assignment]
        self._networks = [ipaddress.ip_network(one, strict=False) for one in trusted]
        self._root_path = settings.root_path

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass one request or websocket through."""
        if scope["type"] not in {"http", "websocket"}:
            await self._app(scope, receive, send)
            return
        given = Headers(scope=scope)
        scope.setdefault("state", {})["proxied"] = any(name in given for name in FORWARDED)
        trusted = self._trusts((scope.get("client") or ("", 0))[0])
        prefix = _prefix(given) if trusted else None
        _set_root(scope, self._root_path if prefix is None else prefix)
        headers = MutableHeaders(scope=scope)
        if trusted and "x-forwarded-host" in given:
            headers["host"] = given["x-forwarded-host"].split(",")[0].strip()
        del headers["x-forwarded-prefix"]  # the dashboard's framework would believe it of anybody
        await self._app(scope, receive, _prefixing(scope["root_path"], send))

    def _trusts(self, address: str) -> bool:
        try:
            asks = ipaddress.ip_address(address)
        except ValueError:
            return False
        return any(asks in network for network in self._networks)


def inner_path(scope: Scope) -> str:
    """The path within the service, without the sub-path."""
    path: str = scope["path"]
    return path.removeprefix(scope.get("root_path", "")) or "/"


def _prefix(headers: Headers) -> str | None:
    """The sub-path that a proxy names, None when it names none or nothing that is one."""
    said = headers.get("x-forwarded-prefix", "").rstrip("/")
    return said if said and _PREFIX.fullmatch(said) else None


def _set_root(scope: Scope, prefix: str) -> None:
    """Whether or not the proxy took the sub-path off: ASGI has it in `path` and in `root_path`."""
    path: str = scope["path"]
    if prefix and path != prefix and not path.startswith(f"{prefix}/"):
        scope["path"] = prefix + path
        scope["raw_path"] = prefix.encode() + scope.get("raw_path", path.encode())
    scope["root_path"] = prefix


def _prefixing(prefix: str, send: Send) -> Send:
    """The send channel, which puts the sub-path before a `Location` that is a path of the service."""
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
