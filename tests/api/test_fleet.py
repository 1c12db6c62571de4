"""Registering vehicles: which names and system ids are free, also while the link is being opened."""

import asyncio
import socket
from pathlib import Path
from typing import Any

import pytest

from skyfolio.api.common.errors import ConflictError
from skyfolio.api.common.settings import Settings
from skyfolio.api.fleet.vehicle_view import VehicleView
from skyfolio.api.http.app import create_app
from skyfolio.api.service import Service
from skyfolio.mavlink_bridge.senders import SenderKind, SenderNotice
from tests.ports import free_port


async def test_when_something_counts_is_a_setting_that_reaches_the_classifier(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SKYFOLIO_TIMING", '{"low_battery": 0.4, "full_again": 0.5}')
    settings = Settings(
        database_url=f"sqlite+aiosqlite:///{tmp_path}/service.db",
        fleet_url=f"udpin://127.0.0.1:{free_port(socket.SOCK_DGRAM)}",
        heartbeat_lost_s=7.0,
        warm_up=False,
    )
    app = create_app(settings)
    async with app.router.lifespan_context(app):
        service: Service = app.state.service
        await service.fleet.register("uav-1", 7)
        assert service.fleet.link.classifier.timing.low_battery == 0.4
        assert service.fleet.link.monitor.lost_after_s == 7.0
    monkeypatch.setenv("SKYFOLIO_TIMING", '{"low_battery": 0.4}')
    with pytest.raises(ValueError, match=r"full_again: 0\.25 must lie in \(0\.4, 1\]"):
        Settings()


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


async def test_a_telemetry_log_that_cannot_be_written_is_one_event_and_the_flight_goes_on(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    settings = Settings(
        database_url=f"sqlite+aiosqlite:///{tmp_path}/service.db",
        fleet_url=f"udpin://127.0.0.1:{free_port(socket.SOCK_DGRAM)}",
        telemetry_log_dir=tmp_path / "file" / "logs",
        warm_up=False,
    )
    app = create_app(settings)
    async with app.router.lifespan_context(app):
        service: Service = app.state.service
        told: asyncio.Queue[dict[str, object]] = asyncio.Queue()
        service.events.listeners.append(lambda event: told.put_nowait({"kind": event.kind, **event.data}))
        await service.fleet.register("uav-1", 7)
        with service.fleet.recorded("op-1"):
            while (event := await asyncio.wait_for(told.get(), 10))["kind"] != "telemetry_log":
                pass
    assert event["operation_id"] == "op-1"
    assert "Not a directory" in str(event["error"])


async def test_who_may_be_another_aircraft_is_a_preflight_warning_until_it_is_registered_anew(tmp_path: Path) -> None:
    settings = Settings(
        database_url=f"sqlite+aiosqlite:///{tmp_path}/service.db",
        fleet_url=f"udpin://127.0.0.1:{free_port(socket.SOCK_DGRAM)}",
        warm_up=False,
    )
    app = create_app(settings)
    async with app.router.lifespan_context(app):
        fleet = app.state.service.fleet
        await fleet.register("uav-1", 7)
        told: dict[str, Any] = {"system_id": 7, "component_id": 1, "before": "10.0.0.1:14550", "now": "10.0.0.66:9"}
        fleet.news.note_sender(SenderNotice(kind=SenderKind.MOVED, signed=True, **told))
        assert fleet.news.doubts_about(7) == []
        fleet.news.note_sender(SenderNotice(kind=SenderKind.CONTESTED, signed=False, **told))
        (finding,) = fleet.news.doubts_about(7)
        assert finding.found == "two senders: 10.0.0.1:14550, then 10.0.0.66:9"
        await fleet.remove("uav-1")
        assert fleet.news.doubts_about(7) == []
