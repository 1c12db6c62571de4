"""The link's port as MAVSDK implements it: one `Mavsdk` object for the fleet, with raw bytes in and out.

MAVSDK's callbacks run on threads of its own; everything is handed over to the event loop.
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable, Collection
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress

from mavsdk import ComponentType, Configuration, ForwardingOption, Mavsdk, System
from mavsdk.plugins.mavlink_direct import MavlinkDirect, MavlinkDirectError, MavlinkMessage

from skyfolio.mavlink_bridge.heartbeat import AUTOPILOT
from skyfolio.mavlink_bridge.mavsdk_log import to_python_logging
from skyfolio.mavlink_bridge.message_port import NotSentError, Receive
from skyfolio.mavlink_bridge.mission_messages import GROUND, Message

MAX_THREADS = 2
"""Blocking calls at once: MAVSDK is only asked which systems it has discovered."""


class MavsdkPort:
    """A `MessagePort`."""

    def __init__(
        self,
        now_s: Callable[[], float],
        to_vehicles: Callable[[bytes], object],
        on_new_system: Callable[[], None],
    ) -> None:
        to_python_logging()
        self._now_s = now_s
        self._loop = loop = asyncio.get_running_loop()
        self._pool = ThreadPoolExecutor(MAX_THREADS, thread_name_prefix="mavsdk")
        self._systems: dict[int, System] = {}
        self._direct: dict[int, MavlinkDirect] = {}
        self.mavsdk = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
        self.mavsdk.add_any_connection_with_handle_and_forwarding("raw://", ForwardingOption.OFF)
        self.mavsdk.subscribe_raw_bytes_to_be_sent(to_vehicles)
        self.mavsdk.subscribe_on_new_system(lambda _user_data: loop.call_soon_threadsafe(on_new_system))

    def take_in(self, data: bytes) -> None:
        """Take in whole frames that vehicles have sent."""
        self.mavsdk.pass_received_raw_bytes(data)

    async def systems(self) -> Collection[int]:
        """Return the ids of the systems that were heard so far."""
        found = await self._loop.run_in_executor(self._pool, self.mavsdk.get_systems)
        self._systems = {int(system.get_system_id()): system for system in found}
        return self._systems.keys()

    def listen(self, system_id: int, names: Collection[str], receive: Receive) -> None:
        """Hand over each of these messages of a system that `systems` has returned."""

        def hand_over(message: MavlinkMessage, _user_data: object) -> None:
            """Keep only what this autopilot itself sent, and stamp it; runs on MAVSDK's thread."""
            if message.system_id == system_id and message.component_id == AUTOPILOT:
                heard_s = self._now_s()
                with suppress(RuntimeError):  # the loop has ended: there is nobody to tell
                    self._loop.call_soon_threadsafe(deliver, message.message_name, message.fields_json, heard_s)

        def deliver(name: str, fields_json: str, heard_s: float) -> None:
            receive(name, json.loads(fields_json), heard_s)

        direct = self._direct[system_id] = MavlinkDirect(self._systems[system_id])
        for name in names:
            direct.subscribe_message(name, hand_over)

    def send(self, system_id: int, message: Message) -> None:
        """Send a message to the autopilot of a system that is listened to. Raises NotSentError."""
        wanted = MavlinkMessage(message.name, *GROUND, system_id, AUTOPILOT, json.dumps(message.fields))
        try:
            self._direct[system_id].send_message(wanted)
        except MavlinkDirectError as failed:
            raise NotSentError(failed.result.name) from failed

    async def close(self) -> None:
        """Let running MAVSDK calls time out, and end it."""
        await asyncio.to_thread(self._pool.shutdown)
        await asyncio.to_thread(self.mavsdk.destroy)
