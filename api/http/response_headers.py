"""Security headers of every response: what a page may load, who may frame it, what it may reveal to others.

Responses of the REST interface load nothing. Pages have a policy of their own; the dashboard's framework compiles its
templates in the browser and starts from inline scripts, which its policy must allow, but nothing from other hosts.
"""

from __future__ import annotations

import base64
import re
from hashlib import sha256
from urllib.parse import urlsplit

from starlette.datastructures import MutableHeaders

CLOSED = "default-src 'none'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
FIXED = {
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
    "referrer-policy": "same-origin",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
}
_SCRIPT = re.compile(r"<script>(.*?)</script>", re.DOTALL)


def add(headers: MutableHeaders, *, dashboard: str | None, request_id: str) -> None:
    """Add the headers that the response does not set itself.

    dashboard: the content security policy, when the response is part of the dashboard.
    """
    headers["x-request-id"] = request_id
    for name, value in FIXED.items():
        headers[name] = value
    headers.setdefault("content-security-policy", dashboard or CLOSED)
    headers.setdefault("cache-control", "no-store")


def dashboard_policy(tile_url: str | None) -> str:
    """Return the policy of the dashboard's pages; images may also come from the map server."""
    tiles = ""
    if tile_url is not None:
        parts = urlsplit(tile_url)
        host = re.sub(r"\{[^}]*\}", "*", parts.netloc)
        tiles = f" {parts.scheme}://{host}"
    return (
        "default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval'; style-src 'self' 'unsafe-inline'; "
        f"img-src 'self' data: blob:{tiles}; font-src 'self' data:; object-src 'none'; base-uri 'none'; "
        "form-action 'self'; frame-ancestors 'none'"
    )


def page_policy(html: str) -> str:
    """Return the policy of a page of this service: its own inline scripts and no others."""
    digests = (base64.b64encode(sha256(script.encode()).digest()).decode() for script in _SCRIPT.findall(html))
    scripts = " ".join(f"'sha256-{digest}'" for digest in digests)
    return (
        f"default-src 'self'; script-src 'self' {scripts}; style-src 'self' 'unsafe-inline'; img-src 'self' data:; "
        "worker-src 'self' blob:; object-src 'none'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    )
