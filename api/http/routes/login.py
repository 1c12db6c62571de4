"""Sign-in of the web page: the key becomes a cookie, since browsers cannot send headers with an event stream."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Request, Response
from fastapi.responses import HTMLResponse
from pydantic import BaseModel, ConfigDict, Field

from skyfolio.api.common.errors import UnauthorizedError
from skyfolio.api.dashboard.port import COOKIE
from skyfolio.api.http.response_headers import page_policy
from skyfolio.api.http.routes.deps import ServiceDep

router = APIRouter(tags=["service"])
PAGE = """<!doctype html><html lang="en"><meta charset="utf-8"><link rel="icon" href="data:,">
<title>skyfolio: sign in</title>
<body style="font:16px sans-serif;max-width:28em;margin:15vh auto"><h1>skyfolio</h1>
<form id="f"><label>API key <input id="k" type="password" autocomplete="off" autofocus style="width:100%"></label>
<p><button>Sign in</button> <span id="s" role="status"></span></p></form><script>
document.getElementById("f").onsubmit = async (e) => { e.preventDefault();
  const r = await fetch("login", {method: "POST", headers: {"content-type": "application/json"},
    body: JSON.stringify({key: document.getElementById("k").value})});
  if (r.ok) location.href = "ui/"; else document.getElementById("s").textContent =
    r.status === 401 ? "This key is unknown." : (await r.json()).detail; };
</script></body></html>"""


class LoginRequest(BaseModel):
    """An API key."""

    model_config = ConfigDict(extra="forbid")

    key: Annotated[str, Field(min_length=1, max_length=200)]


@router.get("/login", response_class=HTMLResponse)
async def show_login() -> HTMLResponse:
    """Return the sign-in form."""
    return HTMLResponse(PAGE, headers={"content-security-policy": page_policy(PAGE)})


@router.post("/login", status_code=204)
async def log_in(body: LoginRequest, service: ServiceDep, request: Request, response: Response) -> None:
    """Keep the key in a cookie that scripts cannot read and other sites cannot send."""
    client = request.client.host if request.client else "unknown"
    if await service.authenticator.identify(client, body.key) is None:
        raise UnauthorizedError("key: is unknown")
    response.set_cookie(
        COOKIE,
        body.key,
        httponly=True,
        samesite="strict",
        secure=request.url.scheme == "https",
        path=request.scope.get("root_path") or "/",
        max_age=86_400,
    )
