"""One vehicle on the link: messages to it and from it, its telemetry, and waiting for something to become true."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from math import inf, isfinite
from typing import Any, Protocol, TypeVar

from skyfolio.mavlink_bridge.answers import CommandAnswer
from skyfolio.mavlink_bridge.autopilots import Autopilot, FlightMode
from skyfolio.mavlink_bridge.heartbeat import AUTOPILOT
from skyfolio.mavlink_bridge.items import MissionItem
from skyfolio.mavlink_bridge.message_port import MessagePort, NotSentError
from skyfolio.mavlink_bridge.mission_messages import Message
from skyfolio.mavlink_bridge.open_commands import ACK, OpenCommands
from skyfolio.mavlink_bridge.profile import AutopilotProfile
from skyfolio.mavlink_bridge.profiles import unknown_autopilot
from skyfolio.mavlink_bridge.round_trip import RoundTrip
from skyfolio.mavlink_bridge.status_texts import StatusTexts
from skyfolio.mavlink_bridge.telemetry import MESSAGES, TelemetryState

Result = TypeVar("Result")

_ANSWERS = ("MISSION_REQUEST_INT", "MISSION_REQUEST", "MISSION_COUNT", "MISSION_ITEM_INT", "PARAM_VALUE")
"""Messages that only mean something to the current conversation."""
_NEWS = ("STATUSTEXT", "MISSION_ITEM_REACHED")
"""Messages that are no part of telemetry, and that `on_message` gets all the same."""

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
DEAD_S = 2.5
"""Fleet seconds without any message, two heartbeats missed, after which the link was dead and not slow."""
OFF_S = 5.0
"""Fleet seconds without any message after which a vehicle on the ground may have been switched off meanwhile."""
_REQUEST = 512
_NEVER = frozenset({CommandAnswer.DENIED, CommandAnswer.UNSUPPORTED})
"""Answers to MAV_CMD_REQUEST_MESSAGE that will be the same next time."""


class NotDone(Exception):  # noqa: N818 (ends one command of one vehicle; becomes its result's error text)
    """The vehicle did not do it; the text says what was seen instead."""


class Clock(Protocol):
    """A clock of fleet time; read from the port's threads too."""

    def now(self) -> float:
        """Return fleet seconds, which never run backwards."""
        ...


class Conversation(Protocol):
    """A protocol without I/O: `VerifiedUpload`, `Download`, `ParameterRead`. `ended` is true once it is over."""

    @property
    def ended(self) -> object:
        """Return whether it is over."""

    @property
    def due_s(self) -> float:
        """Return the fleet second at which `tick` has to be called next."""

    def start(self, now_s: float) -> list[Message]:
        """Return the first messages to send."""

    def handle(self, name: str, fields: dict[str, Any], now_s: float) -> list[Message]:
        """Take in a message of the vehicle, and return what to send in response."""

    def tick(self, now_s: float) -> list[Message]:
        """Return what to send again, or give up."""

    def give_up(self) -> None:
        """End it as failed."""


class Vehicle:
    """One system id, reached through `port`. It lives on the event loop.

    `on_message(vehicle, name, fields, heard_s)` is called with fleet seconds for each message of component 1 that is
    part of telemetry, and for STATUSTEXT.
    """

    def __init__(
        self,
        system_id: int,
        *,
        port: MessagePort,
        loop: asyncio.AbstractEventLoop,
        on_message: Callable[[Vehicle, str, dict[str, Any], float], None],
    ) -> None:
        self.system_id = system_id
        self.state = TelemetryState(self.system_id)
        self.texts = StatusTexts()
        """What it reported in words, at the event loop's times."""
        self.heard = False
        """Whether its autopilot (component 1) has sent a heartbeat."""
        self.announce: Callable[[FlightMode, bool], None] = lambda _mode, _going_on: None
        """Called with each mode before it is commanded (True), and when the command has ended (False)."""
        self.start_item = 1
        """The item of the mission on board that a vehicle in the air begins with."""
        self.on_board: tuple[MissionItem, ...] | None = None
        """The mission it is proven to have; None: unknown, as while another one is sent."""
        self.round_trip = RoundTrip()
        """The round trip that all requests to it have measured."""
        self.unsupported: set[int] = set()
        """Commands (MAV_CMD) it has answered UNSUPPORTED."""
        self.flies_our_speed = False
        """Whether a speed was ordered in flight and not taken back: it outlives the mode it was meant for."""
        self.armed_at_s = -inf
        """When we armed it, on the event loop's clock."""
        self._port = port
        self._loop = loop
        self._on_message = on_message
        self._changed = asyncio.Event()
        self._talking = asyncio.Lock()
        self._inbox: asyncio.Queue[tuple[str, dict[str, Any]]] | None = None
        self._heard_s = inf
        """When the last message was received, fleet seconds."""
        self._commands = OpenCommands(self._send_all, self.round_trip, loop)
        self._not_on_request: set[int] = set()
        self._restarts = 0
        port.listen(system_id, (*MESSAGES, *_ANSWERS, *_NEWS, ACK), self._take_in)

    @property
    def autopilot(self) -> Autopilot:
        """Return which autopilot it is, from its HEARTBEAT. Raises NotDone for one without a profile."""
        return self.profile.autopilot

    @property
    def profile(self) -> AutopilotProfile:
        """Return the profile of its autopilot. Raises NotDone, naming the autopilot, where there is none."""
        if self.state.profile is None:
            raise NotDone(str(unknown_autopilot(self.state.mav_autopilot)))
        return self.state.profile

    @contextmanager
    def commanding(self, mode: FlightMode) -> Iterator[None]:
        """Announce a mode that is commanded meanwhile, so that the change is not attributed to anybody else."""
        self.announce(mode, True)
        try:
            yield
        finally:
            self.announce(mode, False)

    def send(self, message: Message) -> None:
        """Send one message, unconfirmed. Raises NotDone if the link does not take it."""
        try:
            self._port.send(self.system_id, message)
        except NotSentError as failed:
            raise NotDone(f"{message.name} was not sent: {failed}") from failed

    async def command(self, number: int, *params: float | None) -> None:
        """Send COMMAND_LONG with up to seven parameters (None: NaN), repeated until it is answered.

        Raises NotDone unless it is accepted.
        """
        await self._command(self.command_message(number, *params))

    def command_message(self, number: int, *params: float | None) -> Message:
        """Return COMMAND_LONG as `command` sends it, to be sent unconfirmed."""
        return Message("COMMAND_LONG", {"command": number, "confirmation": 0, **self._address, **_numbered(params)})

    async def command_int(self, number: int, *, frame: int, x: int, y: int, z: float, **params: float | None) -> None:
        """Send COMMAND_INT with a place (1e-7 degrees). Raises NotDone unless it is accepted."""
        fields = {"command": number, **self._address, "frame": frame, "x": x, "y": y, "z": z, **params}
        await self._command(Message("COMMAND_INT", fields))

    async def request(self, message_id: int) -> None:
        """Request one message (MAV_CMD_REQUEST_MESSAGE), unless the vehicle has refused that once."""
        if message_id in self._not_on_request:
            return
        answer = await self._commands.ask(self.command_message(_REQUEST, float(message_id)))
        if answer.answer in _NEVER:
            self._not_on_request.add(message_id)

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
        """Return whether the condition became true within `timeout_s` wall seconds.

        It is checked after each message.
        """
        try:
            async with asyncio.timeout(timeout_s):
                while not condition():
                    await self._changed.wait()
        except TimeoutError:
            return condition()
        return True

    async def _turn(self, conversation: Conversation, inbox: asyncio.Queue[tuple[str, dict[str, Any]]]) -> bool:
        """Handle the next message, or the next thing that is due, and return whether it was a message.

        Messages that waited for a slow loop are taken in first.
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

    async def _command(self, message: Message) -> None:
        call = await self._commands.ask(message)
        if call.error is not None:
            number = int(message.fields["command"])
            if call.answer is CommandAnswer.UNSUPPORTED:
                self.unsupported.add(number)
            raise NotDone(f"{_NAMES.get(number, number)}: {call.error}")

    @property
    def _address(self) -> dict[str, int]:
        return {"target_system": self.system_id, "target_component": AUTOPILOT}

    def _take_in(self, name: str, fields: dict[str, Any], heard_s: float) -> None:
        now_s = self._loop.time()
        silent_s, self._heard_s = heard_s - self._heard_s, heard_s
        if silent_s > DEAD_S:
            self._commands.heard_again(now_s)
        if silent_s >= OFF_S and not self.state.armed:
            self.state.forget_before(heard_s)
        self._commands.alive(now_s)
        if name == ACK:
            self._commands.take_answer(fields, now_s)
            return
        if self._inbox is not None:
            self._inbox.put_nowait((name, fields))
        if name in _ANSWERS:
            return
        if name == "STATUSTEXT":
            self.texts.hear(fields, now_s)
        elif name not in _NEWS:
            self.state.fold(name, fields, heard_s)
        if self.state.restarts != self._restarts:
            self._restarts = self.state.restarts
            self._learn_anew()
        self.heard = self.heard or self.state.heard
        self._on_message(self, name, fields, heard_s)
        changed, self._changed = self._changed, asyncio.Event()
        changed.set()

    def _learn_anew(self) -> None:
        """Forget what it has refused, and the speed that was ordered: all of that ends with a restart.

        The missions on board stay there, but nothing proves it.
        """
        self.unsupported.clear()
        self._not_on_request.clear()
        self.flies_our_speed, self.on_board = False, None


def _numbered(params: Sequence[float | None]) -> dict[str, float | None]:
    """Return param1 to param7; those not given are 0."""
    return {f"param{n}": value for n, value in enumerate([*params, *[0.0] * (7 - len(params))], start=1)}
