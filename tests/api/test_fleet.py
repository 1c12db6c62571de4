"""Registering vehicles: which names and system ids are free, also while the link is being opened."""

import asyncio
import socket
from pathlib import Path

from api.app import create_app
from api.errors import ConflictError
from api.fleet import VehicleView
from api.service import Service
from api.settings import Settings
from tests.ports import free_port


async def test_of_two_vehicles_that_claim_a_system_id_at_once_one_gets_it(tmp_path: Path) -> None:
    settings = Settings(
        database_url=f"sqlite+aiosqlite:///{tmp_path}/service.db",
        fleet_url=f"udpin://127.0.0.1:{free_port(socket.SOCK_DGRAM)}",
        warm_up=False,
    )
    app = create_app(settings)
    async with app.router.lifespan_context(app):
        service: Service = app.state.service
        asked = [service.fleet.register(uav, 7) for uav in ("uav-1", "uav-2")]
        first, second = await asyncio.gather(*asked, return_exceptions=True)
        assert isinstance(first, VehicleView)
        assert isinstance(second, ConflictError)
        assert [view.uav_id for view in service.fleet.views()] == ["uav-1"]
