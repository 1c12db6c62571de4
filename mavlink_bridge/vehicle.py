"""One vehicle on the link: messages to it and from it, its telemetry, and waiting for something to become true."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from enum import IntEnum
from math import isfinite
from typing import Any, Protocol, TypeVar

from mavsdk import System
from mavsdk.plugins.mavlink_direct import MavlinkDirect, MavlinkDirectError, MavlinkMessage

from mavlink_bridge.autopilots import Autopilot, FlightMode
from mavlink_bridge.heartbeat import AUTOPILOT
from mavlink_bridge.items import MissionItem
from mavlink_bridge.mission_messages import GROUND, Message
from mavlink_bridge.telemetry import MESSAGES, TelemetryState
from mavlink_bridge.texts import Texts

Result = TypeVar("Result")

_ANSWERS = ("MISSION_REQUEST_INT", "MISSION_REQUEST", "MISSION_COUNT", "MISSION_ITEM_INT", "PARAM_VALUE")
"""Messages that only mean something to the conversation that is going on."""
_NEWS = ("STATUSTEXT",)
"""Messages no telemetry is made of, that `on_message` hears all the same."""

_NAMES = {
    21: "land",
    22: "take-off",
    176: "set mode",
    178: "change speed",
    192: "go to",
    224: "set current item",
    300: "start mission",
    400: "arm",
    511: "set message rate",
    512: "request message",
}


ANSWER_S = 1.0
"""Wall seconds without any message before a vehicle whose link was declared lost is given up."""


class NotDone(Exception):  # noqa: N818 (ends one command of one vehicle; becomes its result's error text)
    """The vehicle did not do it; the text says what was seen instead."""


class Clock(Protocol):
    """Anything that tells fleet time. Read from MAVSDK's threads too."""

    def now(self) -> float:
        """Fleet seconds; never runs backwards."""
        ...


class Conversation(Protocol):
    """A protocol without I/O: `VerifiedUpload`, `Download`, `ParameterRead`. `ended` is true once it is over."""

    @property
    def ended(self) -> object: ...

    @property
    def due_s(self) -> float: ...

    def start(self, now_s: float) -> list[Message]: ...

    def handle(self, name: str, fields: dict[str, Any], now_s: float) -> list[Message]: ...

    def tick(self, now_s: float) -> list[Message]: ...

    def give_up(self) -> None: ...


class CommandAnswer(IntEnum):
    """MAV_RESULT of COMMAND_ACK."""

    ACCEPTED = 0
    TEMPORARILY_REJECTED = 1
    DENIED = 2
    UNSUPPORTED = 3
    FAILED = 4
    IN_PROGRESS = 5
    CANCELLED = 6


class Vehicle:
    """One system id. Lives on the event loop; MAVSDK's callbacks are handed over to it.

    `on_message(vehicle, name, fields, heard_s)` is called for each message of component 1 that telemetry is made of,
    and for STATUSTEXT, with fleet seconds.
    """

    def __init__(
        self,
        system: System,
        *,
        clock: Clock,
        pool: Executor,
        loop: asyncio.AbstractEventLoop,
        on_message: Callable[[Vehicle, str, dict[str, Any], float], None],
    ) -> None:
        self.system_id = int(system.get_system_id())
        self.state = TelemetryState(self.system_id)
        self.texts = Texts()
        """What it said in words, at the event loop's times."""
        self.heard = False
        """Whether its autopilot (component 1) has sent a heartbeat."""
        self.announce: Callable[[FlightMode, bool], None] = lambda _mode, _going_on: None
        """Told of each mode before it is commanded (True), and when the command has ended (False)."""
        self.start_item = 1
        """The item of the mission on board that a vehicle in the air begins with."""
        self.on_board: tuple[MissionItem, ...] | None = None
        """The mission it is proven to have; None: not known."""
        self._clock = clock
        self._pool = pool
        self._loop = loop
        self._on_message = on_message
        self._changed = asyncio.Event()
        self._talking = asyncio.Lock()
        self._inbox: asyncio.Queue[tuple[str, dict[str, Any]]] | None = None
        self._direct = MavlinkDirect(system)
        for name in (*MESSAGES, *_ANSWERS, *_NEWS):
            self._direct.subscribe_message(name, self._receive)

    @property
    def autopilot(self) -> Autopilot:
        """Which autopilot it is, from its heartbeat. Raises NotDone for one nobody compiles for."""
        if self.state.autopilot is None:
            raise NotDone("its autopilot is neither PX4 nor ArduPilot")
        return self.state.autopilot

    @contextmanager
    def commanding(self, mode: FlightMode) -> Iterator[None]:
        """Announce a mode that is commanded meanwhile, so that nobody else is taken to have chosen it."""
        self.announce(mode, True)
        try:
            yield
        finally:
            self.announce(mode, False)

    def send(self, message: Message) -> None:
        """Send one message, unconfirmed."""
        self._direct.send_message(self._message(message.name, message.fields))

    async def command(self, number: int, *params: float | None) -> None:
        """COMMAND_LONG with up to seven parameters (None: not given), repeated until answered.

        Raises NotDone unless it is accepted.
        """
        await self._command("COMMAND_LONG", number, _numbered(params))

    def command_message(self, number: int, *params: float) -> Message:
        """COMMAND_LONG as `command` sends it, to be sent unconfirmed."""
        return Message("COMMAND_LONG", {"command": number, "confirmation": 0, **self._address, **_numbered(params)})

    async def command_int(self, number: int, *, frame: int, x: int, y: int, z: float, **params: float | None) -> None:
        """COMMAND_INT with a place (1e-7 degrees). Raises NotDone unless it is accepted."""
        await self._command("COMMAND_INT", number, {"frame": frame, "x": x, "y": y, "z": z, **params})

    async def converse(self, conversation: Conversation, given_up: Callable[[], bool] = lambda: False) -> None:
        """Carry a protocol to its end; one at a time for each vehicle.

        `given_up` ends it early, but not while the vehicle still answers: an answer is better evidence than a verdict.
        """
        async with self._talking:
            self._inbox = asyncio.Queue()
            try:
                heard_s = self._loop.time()
                self._send_all(conversation.start(heard_s))
                while not conversation.ended:
                    if await self._turn(conversation, self._inbox):
                        heard_s = self._loop.time()
                    elif given_up() and self._loop.time() - heard_s >= ANSWER_S:
                        conversation.give_up()
            finally:
                self._inbox = None

    async def wait_until(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        """Whether the condition came true within `timeout_s` wall seconds; looked at after each message."""
        try:
            async with asyncio.timeout(timeout_s):
                while not condition():
                    await self._changed.wait()
        except TimeoutError:
            return condition()
        return True

    async def _turn(self, conversation: Conversation, inbox: asyncio.Queue[tuple[str, dict[str, Any]]]) -> bool:
        """The next message, or the next thing that is due; what a slow loop let pile up is taken in first.

        Whether it was a message.
        """
        wait_s = conversation.due_s - self._loop.time()
        heard: tuple[str, dict[str, Any]] | None = None
        if not inbox.empty():
            heard = inbox.get_nowait()
        elif wait_s > 0:
            try:
                async with asyncio.timeout(wait_s if isfinite(wait_s) else None):
                    heard = await inbox.get()
            except TimeoutError:
                heard = None
        now = self._loop.time()
        self._send_all(conversation.tick(now) if heard is None else conversation.handle(*heard, now))
        return heard is not None

    def _send_all(self, messages: list[Message]) -> None:
        for message in messages:
            self.send(message)

    async def _command(self, kind: str, number: int, fields: dict[str, Any]) -> None:
        wanted = self._message(kind, {"command": number, **self._address, **fields})
        try:
            answer = await self._loop.run_in_executor(self._pool, self._direct.send_command, wanted)
        except MavlinkDirectError as failed:
            raise NotDone(f"{_NAMES.get(number, number)}: {failed.result.name}") from failed
        result = CommandAnswer(int(json.loads(answer.fields_json)["result"]))
        if result is not CommandAnswer.ACCEPTED:
            raise NotDone(f"{_NAMES.get(number, number)}: {result.name}")

    @property
    def _address(self) -> dict[str, int]:
        return {"target_system": self.system_id, "target_component": AUTOPILOT}

    def _message(self, name: str, fields: dict[str, Any]) -> MavlinkMessage:
        return MavlinkMessage(name, *GROUND, self.system_id, AUTOPILOT, json.dumps(fields))

    def _receive(self, message: MavlinkMessage, _user_data: object) -> None:
        """On MAVSDK's thread: keep only what this very autopilot sent, stamp it, hand it over."""
        if message.system_id == self.system_id and message.component_id == AUTOPILOT:
            heard_s = self._clock.now()
            self._loop.call_soon_threadsafe(self._take_in, message.message_name, message.fields_json, heard_s)

    def _take_in(self, name: str, fields_json: str, heard_s: float) -> None:
        fields = json.loads(fields_json)
        if self._inbox is not None:
            self._inbox.put_nowait((name, fields))
        if name in _ANSWERS:
            return
        if name == "STATUSTEXT":
            self.texts.hear(fields, self._loop.time())
        else:
            self.state.fold(name, fields, heard_s)
        self.heard = self.heard or name == "HEARTBEAT"
        self._on_message(self, name, fields, heard_s)
        changed, self._changed = self._changed, asyncio.Event()
        changed.set()


def _numbered(params: Sequence[float | None]) -> dict[str, float | None]:
    """param1 to param7; those not given are 0."""
    return {f"param{n}": value for n, value in enumerate([*params, *[0.0] * (7 - len(params))], start=1)}
