"""Checks of `Host`, `Origin` and content type: a browser on this machine does not always act for its user.

A page of any site can make a browser send requests to loopback (a form needs no permission), and DNS rebinding lets it
even read the responses. So the `Host` must be one of this service, a page that sends requests must have come from that
host (RFC 6454; every browser states it in `Origin` or `Sec-Fetch-Site`), and a body must be of a type that no form can
send.
"""

from __future__ import annotations

import ipaddress
import re
import socket
from urllib.parse import SplitResult, urlsplit

from starlette.datastructures import Headers

from skyfolio.api.common.errors import CrossSiteError, MediaTypeError, MisdirectedError
from skyfolio.api.common.settings import Settings, listed

_JSON = re.compile(r"application/(?:[\w.-]+\+)?json\s*(?:;.*)?", re.IGNORECASE)
_PORTS = {"http": 80, "https": 443}


class AllowedHosts:
    """The names under which a service may be reached."""

    def __init__(self, settings: Settings) -> None:
        self._loopback_only = settings.on_loopback
        names = {"localhost", _bare(settings.host), *map(_bare, listed(settings.allowed_hosts))}
        if not self._loopback_only:
            names.add(_bare(socket.gethostname()))
        self._names = {name for name in names if not name.startswith("*")}
        self._below = tuple(name.removeprefix("*") for name in names if name.startswith("*"))

    def require(self, headers: Headers) -> SplitResult:
        """Return the host that was asked for. Raises MisdirectedError when it is none of this service.

        An IP address need not be listed unless only loopback is bound: DNS rebinding needs a name.
        """
        hosts = headers.getlist("host")
        host = _split(f"//{hosts[0]}") if len(hosts) == 1 else None
        if host is None or not self._knows(_bare(host.hostname or "")):
            sent = repr(hosts[0][:100]) if hosts else "nothing"
            raise MisdirectedError(
                f"Host: {sent} is not a name of this service; SKYFOLIO_ALLOWED_HOSTS can name more (docs/security.md)"
            )
        return host

    def _knows(self, name: str) -> bool:
        if name in self._names or name.endswith(self._below):
            return True
        try:
            address = ipaddress.ip_address(name)
        except ValueError:
            return False
        return address.is_loopback or not self._loopback_only


def require_same_origin(headers: Headers, host: SplitResult, *, safe: bool) -> None:
    """Refuse what a page of another origin had a browser send. Raises CrossSiteError.

    safe: whether the method changes nothing; then a browser need not say where the page came from.
    """
    origin = headers.get("origin")
    if origin is None:
        if not safe and headers.get("sec-fetch-site", "none") not in {"same-origin", "none"}:
            raise CrossSiteError("Sec-Fetch-Site: a page of another origin may not ask this service")
        return
    page = _split(origin)
    if page is None or page.scheme not in _PORTS or _where(page, page.scheme) != _where(host, page.scheme):
        raise CrossSiteError(
            f"Origin: {origin[:100]!r} is not {host.netloc[:100]!r}; a proxy must pass the Host on with its port"
        )


def require_json(headers: Headers) -> None:
    """Refuse a body that is not JSON, also one that a form could send. Raises MediaTypeError."""
    body = "transfer-encoding" in headers or headers.get("content-length", "0").strip("0") != ""
    media_type = headers.get("content-type")
    if media_type is None and not body:
        return
    if media_type is None or not _JSON.fullmatch(media_type.strip()):
        raise MediaTypeError(f"Content-Type: {(media_type or 'nothing')[:100]!r} must be application/json")


def _where(url: SplitResult, scheme: str) -> tuple[str, int]:
    return _bare(url.hostname or ""), url.port or _PORTS[scheme]


def _bare(name: str) -> str:
    return name.lower().strip("[]").rstrip(".")


def _split(url: str) -> SplitResult | None:
    """Return the parts of a URL, None unless it is just a host with an optional port."""
    try:
        parts = urlsplit(url)
        _ = parts.port  # raises when it is none
    except ValueError:
        return None
    plain = not (parts.path or parts.query or parts.fragment or "@" in parts.netloc)
    return parts if plain and parts.hostname else None
