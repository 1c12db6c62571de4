"""One vehicle on the link: its MAVSDK plugins, its telemetry, and waiting for something to become true."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable
from concurrent.futures import Executor
from typing import Any, Protocol, TypeVar

from mavsdk import System
from mavsdk.plugins.action import Action
from mavsdk.plugins.mavlink_direct import MavlinkDirect, MavlinkMessage
from mavsdk.plugins.mission_raw import MissionRaw

from mavlink_bridge.heartbeat import AUTOPILOT
from mavlink_bridge.telemetry import MESSAGES, TelemetryState

Result = TypeVar("Result")


class Clock(Protocol):
    """Anything that tells fleet time. Read from MAVSDK's threads too."""

    def now(self) -> float:
        """Fleet seconds; never runs backwards."""
        ...


class Vehicle:
    """One system id. Lives on the event loop; MAVSDK's callbacks are handed over to it.

    `on_heartbeat(vehicle, heard_s)` is called for each HEARTBEAT of component 1, fleet seconds.
    """

    def __init__(
        self,
        system: System,
        *,
        clock: Clock,
        pool: Executor,
        loop: asyncio.AbstractEventLoop,
        on_heartbeat: Callable[[Vehicle, float], None],
    ) -> None:
        self.system_id = int(system.get_system_id())
        self.state = TelemetryState(self.system_id)
        self.heard = False
        """Whether its autopilot (component 1) has sent a heartbeat."""
        self._clock = clock
        self._pool = pool
        self._loop = loop
        self._on_heartbeat = on_heartbeat
        self._changed = asyncio.Event()
        self.action = Action(system)
        self.mission_raw = MissionRaw(system)
        self._direct = MavlinkDirect(system)
        for name in MESSAGES:
            self._direct.subscribe_message(name, self._receive)

    async def call(self, blocking: Callable[..., Result], *arguments: Any) -> Result:
        """Run a blocking MAVSDK call in the fleet's own threads; its time-outs are wall time."""
        return await self._loop.run_in_executor(self._pool, blocking, *arguments)

    async def wait_until(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        """Whether the condition came true within `timeout_s` wall seconds; looked at after each message."""
        try:
            async with asyncio.timeout(timeout_s):
                while not condition():
                    await self._changed.wait()
        except TimeoutError:
            return condition()
        return True

    def _receive(self, message: MavlinkMessage, _user_data: object) -> None:
        """On MAVSDK's thread: keep only what this very autopilot sent, stamp it, hand it over."""
        if message.system_id == self.system_id and message.component_id == AUTOPILOT:
            heard_s = self._clock.now()
            self._loop.call_soon_threadsafe(self._take_in, message.message_name, message.fields_json, heard_s)

    def _take_in(self, name: str, fields_json: str, heard_s: float) -> None:
        self.state.fold(name, json.loads(fields_json), heard_s)
        if name == "HEARTBEAT":
            self.heard = True
            self._on_heartbeat(self, heard_s)
        changed, self._changed = self._changed, asyncio.Event()
        changed.set()
