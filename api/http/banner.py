"""What `skyfolio serve` says on standard error when it listens: where to go. It names no secret."""

from __future__ import annotations

from sqlalchemy.engine import make_url

from skyfolio import __version__
from skyfolio.api.common.settings import Settings, listed


def banner(settings: Settings, host: str, port: int, *, ui: bool) -> str:
    """Return the lines that name every address of the service; host, port: what it is bound to."""
    at = f"http://{f'[{host}]' if ':' in host else host}:{port}"
    fleet = (
        f"the simulated fleet of {settings.simulate}, {settings.time_scale:g} times real time"
        if settings.simulate is not None
        else ", ".join(listed(settings.fleet_url))
    )
    rows = {
        "dashboard": f"{at}/ui" if ui else "off (--no-ui)",
        "REST": f"{at}/v1, described at {at}/docs",
        "metrics": f"{at}/metrics, health at {at}/health",
        "fleet": fleet,
        "database": make_url(settings.database_url).render_as_string(hide_password=True)
        if "://" in settings.database_url
        else settings.database_url,
    }
    lines = [f"skyfolio {__version__} is serving; Ctrl+C stops it, and vehicles fly on", *(
        f"  {name:10} {value}" for name, value in rows.items()
    )]  # fmt: skip
    return "\n".join(lines) + "\n"
