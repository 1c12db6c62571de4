"""Both flavours against MAVProxy, scripted through its console: wp load, wp list, mode auto, param fetch, rtl"""

import asyncio
import os
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from skyfolio.sim import Fleet, ScaledClock, grid_of

HOME = (47.397742, 8.545594)
WAYPOINTS = """QGC WPL 110
0\t1\t0\t16\t0\t0\t0\t0\t47.39774200\t8.54559400\t488.000000\t1
1\t0\t3\t22\t0\t0\t0\t0\t47.39774200\t8.54559400\t20.000000\t1
2\t0\t3\t16\t0\t0\t0\t0\t47.39800000\t8.54559400\t20.000000\t1
3\t0\t3\t16\t0\t0\t0\t0\t47.39800000\t8.54600000\t20.000000\t1
"""
MODULES = "wp,param,mode,arm,cmdlong,misc,link"
pytestmark = pytest.mark.e2e


class Console:
    """MAVProxy's console: says lines and waits for words."""

    def __init__(self, process: asyncio.subprocess.Process) -> None:
        self._process = process
        self.text = ""
        self._from = 0

    async def expect(self, words: str, within_s: float = 90.0) -> None:
        """Wait until MAVProxy has printed some words, after those of the last call."""
        assert self._process.stdout is not None
        try:
            async with asyncio.timeout(within_s):
                while words not in self.text[self._from :]:
                    chunk = await self._process.stdout.read(4096)
                    assert chunk, f"MAVProxy ended before {words!r}: {self.text[-2000:]}"
                    self.text += chunk.decode(errors="replace")
        except TimeoutError:
            pytest.fail(f"MAVProxy did not say {words!r}: {self.text[-2000:]}")
        self._from = self.text.index(words, self._from) + len(words)

    async def say(self, line: str) -> None:
        """Type a line."""
        assert self._process.stdin is not None
        self._process.stdin.write(line.encode() + b"\n")
        await self._process.stdin.drain()


@asynccontextmanager
async def mavproxy(autopilot: str, port: int, folder: Path) -> AsyncIterator[tuple[Fleet, Console]]:
    """Open a fleet of one and a MAVProxy that is connected to it."""
    (folder / "mission.txt").write_text(WAYPOINTS)
    fleet = Fleet(grid_of(1, *HOME, autopilot=autopilot), clock=ScaledClock(5.0), endpoint=f"udpout://127.0.0.1:{port}")
    process = await asyncio.create_subprocess_exec(
        sys.executable,
        str(Path(sys.executable).with_name("mavproxy.py")),
        f"--master=udpin:127.0.0.1:{port}",
        f"--default-modules={MODULES}",
        f"--state-basedir={folder}",
        cwd=folder,
        env={**os.environ, "PYTHONUNBUFFERED": "1", "HOME": str(folder)},
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.STDOUT,
    )
    try:
        async with fleet:
            console = Console(process)
            await console.expect("Detected vehicle 1:1")
            yield fleet, console
    finally:
        process.kill()
        await process.wait()


async def transfer(console: Console, fleet: Fleet, folder: Path, *, frame: int) -> None:
    """Loads a mission and reads it back; `frame` is the MAV_FRAME the autopilot tells it in."""
    await console.say("param fetch")
    await console.expect(f"parameters to {folder}")
    await console.say("wp load mission.txt")
    await console.expect("Got MISSION_ACK: TYPE_MISSION: ACCEPTED")
    await console.say("wp list")
    await console.expect(f"16 {frame} 47.3980000000 8.5460000000 20.0")
    assert len(fleet.vehicles[1].mission) == 4


async def test_mavproxy_flies_an_arducopter(free_port: int, tmp_path: Path) -> None:
    async with mavproxy("ardupilot", free_port, tmp_path) as (fleet, console):
        await transfer(console, fleet, tmp_path, frame=3)
        await console.say("param set AUTO_OPTIONS 3")
        async with asyncio.timeout(40):
            while fleet.vehicles[1].autopilot.parameters["AUTO_OPTIONS"] != 3.0:  # noqa: ASYNC110
                await asyncio.sleep(0.05)
        await console.say("mode auto")
        await console.expect("Mode AUTO")
        await console.say("arm throttle")
        await console.expect("ARMED")
        await console.expect("waypoint 3")
        await console.say("rtl")
        await console.expect("Mode RTL")
        await console.expect("DISARMED")
        assert fleet.vehicles[1].autopilot.body.distance_to(0.0, 0.0) < 0.5


async def test_mavproxy_flies_a_px4_by_commands_as_it_cannot_name_its_modes(free_port: int, tmp_path: Path) -> None:
    async with mavproxy("px4", free_port, tmp_path) as (fleet, console):
        await transfer(console, fleet, tmp_path, frame=6)
        await console.say("arm throttle")
        await console.expect("ARMED")
        await console.say("long MAV_CMD_MISSION_START 0 0 0 0 0 0 0")
        await console.expect("Mode MISSION")
        await console.expect("waypoint 3")
        await console.say("long MAV_CMD_NAV_RETURN_TO_LAUNCH 0 0 0 0 0 0 0")
        await console.expect("Mode RTL")
        await console.expect("DISARMED", 60.0)
        assert fleet.vehicles[1].autopilot.body.distance_to(0.0, 0.0) < 0.5
