"""The pages `/docs` and `/redoc`, with everything that they need: they work without the internet."""

from __future__ import annotations

from importlib.resources import files

from fastapi import FastAPI, Request
from fastapi.openapi.docs import get_redoc_html, get_swagger_ui_html
from fastapi.responses import HTMLResponse
from fastapi.staticfiles import StaticFiles

from api.headers import page_policy

ASSETS = "docs/assets"
"""Where the pages find their scripts, relative to themselves, below whatever sub-path."""
NO_ICON = "data:,"


def install(app: FastAPI) -> None:
    """Serve both pages."""
    app.mount(f"/{ASSETS}", StaticFiles(directory=str(files("fastapi_offline") / "static")), name="docs-assets")

    async def swagger(_: Request) -> HTMLResponse:
        return _page(
            get_swagger_ui_html(
                openapi_url="openapi.json",
                title=f"{app.title}: the REST interface",
                swagger_js_url=f"{ASSETS}/swagger-ui-bundle.js",
                swagger_css_url=f"{ASSETS}/swagger-ui.css",
                swagger_favicon_url=NO_ICON,
            )
        )

    async def redoc(_: Request) -> HTMLResponse:
        return _page(
            get_redoc_html(
                openapi_url="openapi.json",
                title=f"{app.title}: the REST interface",
                redoc_js_url=f"{ASSETS}/redoc.standalone.js",
                redoc_favicon_url=NO_ICON,
                with_google_fonts=False,
            )
        )

    app.add_route("/docs", swagger, include_in_schema=False)
    app.add_route("/redoc", redoc, include_in_schema=False)


def _page(made: HTMLResponse) -> HTMLResponse:
    html = bytes(made.body).decode()
    return HTMLResponse(html, headers={"content-security-policy": page_policy(html)})
