"""The page `/docs` and its assets, which are all served from here: it works offline."""

from __future__ import annotations

from importlib.resources import files

from fastapi import FastAPI, Request
from fastapi.openapi.docs import get_swagger_ui_html
from fastapi.responses import HTMLResponse
from fastapi.staticfiles import StaticFiles

from skyfolio.api.http.response_headers import page_policy

ASSETS = "docs/assets"
"""Path of the scripts relative to the page, so that any sub-path works."""
NO_ICON = "data:,"


def install(app: FastAPI) -> None:
    """Add the page and its assets to the app."""
    app.mount(f"/{ASSETS}", StaticFiles(directory=str(files("fastapi_offline") / "static")), name="docs-assets")

    async def page(_: Request) -> HTMLResponse:
        response = get_swagger_ui_html(
            openapi_url="openapi.json",
            title=f"{app.title}: the REST interface",
            swagger_js_url=f"{ASSETS}/swagger-ui-bundle.js",
            swagger_css_url=f"{ASSETS}/swagger-ui.css",
            swagger_favicon_url=NO_ICON,
        )
        html = bytes(response.body).decode()
        return HTMLResponse(html, headers={"content-security-policy": page_policy(html)})

    app.add_route("/docs", page, include_in_schema=False)
