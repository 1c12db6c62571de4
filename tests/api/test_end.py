"""The end of the service: it waits for nobody, because vehicles fly on by themselves."""

import asyncio
import socket
import subprocess
import sys
import time
from pathlib import Path

import httpx2
import pytest

from skyfolio.api.common.settings import Settings
from skyfolio.api.service import Service, _ended
from tests.ports import free_port


async def test_a_part_that_hangs_is_left_behind() -> None:
    async def hang() -> None:
        await asyncio.Event().wait()

    await _ended("link", hang(), time.monotonic() - 1.0)


async def test_what_a_part_raises_at_its_end_is_raised() -> None:
    async def fail() -> None:
        raise OSError("no")

    with pytest.raises(OSError, match="no"):
        await _ended("link", fail(), time.monotonic() + 60.0)


async def test_a_task_of_the_service_that_fails_is_started_again_and_readiness_says_so(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    tried = asyncio.Event()

    async def broken(_: Service) -> None:
        tried.set()
        raise KeyError("vehicles")

    monkeypatch.setattr(Service, "_tidy", broken)
    service = await Service.open(Settings(database_url=f"sqlite+aiosqlite:///{tmp_path}/x.db", warm_up=False))
    try:
        await tried.wait()
        await asyncio.sleep(0)
        assert (await service.readiness())["tasks"] == "tidy failed (KeyError: 'vehicles')"
        tried.clear()
        await tried.wait()
        kinds = [event.kind for event in await service.events.after(0)]
        assert "task_failed" in kinds
    finally:
        await service.close()


@pytest.mark.e2e
def test_an_open_event_stream_does_not_keep_the_service_from_ending(tmp_path: Path) -> None:
    port, log = free_port(socket.SOCK_STREAM), tmp_path / "service.log"
    url = f"http://127.0.0.1:{port}"
    command = ["serve", "--port", str(port), "--database-url", f"sqlite+aiosqlite:///{tmp_path}/service.db", "--json"]
    with log.open("wb") as out:
        process = subprocess.Popen([sys.executable, "-m", "skyfolio", *command], stdout=out, stderr=out)
        try:
            while not _is_ready(url):
                assert process.poll() is None, log.read_text()
                time.sleep(0.1)
            with httpx2.stream("GET", f"{url}/v1/events", timeout=60) as stream:
                lines = stream.iter_lines()
                next(lines)
                process.terminate()
                for _ in lines:  # ends with the service's last event, not with an error
                    pass
            assert process.wait(60) == 0
        finally:
            process.kill()
    assert "graceful shutdown exceeded" not in log.read_text()
    assert "left behind" not in log.read_text()


def _is_ready(url: str) -> bool:
    try:
        return httpx2.get(f"{url}/ready", timeout=60).status_code == 200
    except httpx2.TransportError:
        return False
