"""What both flavours of the mission protocol share: plans by type, the messages, and the vehicle behind them.

Messages: MISSION_COUNT, MISSION_REQUEST(_INT), MISSION_ITEM(_INT), MISSION_ACK, MISSION_REQUEST_LIST,
MISSION_CLEAR_ALL, MISSION_SET_CURRENT, for missions, fences and rally points. Time-outs run on the injected protocol
clock: wall seconds when there are sockets, because the ground station at the other end does not hurry when the
simulation does.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple, Protocol

from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.sim.missions import COMMANDS_OF, Mission, MissionItem
from skyfolio.sim.wire import Message

MISSION = dialect.MAV_MISSION_TYPE_MISSION
ALL = dialect.MAV_MISSION_TYPE_ALL
TYPES = tuple(COMMANDS_OF)
CORRUPTION_E7 = 2000
"""How far a corrupted upload moves an item: 1e-7 degrees of latitude, 22 m."""


class Partner(NamedTuple):
    """The system at the other end of a transfer."""

    system_id: int
    component_id: int


class MissionHost(Protocol):
    """The vehicle behind the protocol."""

    @property
    def mission_index(self) -> int:
        """The item being flown."""
        ...

    @property
    def mission_running(self) -> bool:
        """Whether the vehicle is armed and flies its mission."""
        ...

    def plan_accepted(self, mission_type: int, plan: Mission) -> None:
        """Put a complete plan, or the empty one of a clear, into force; called before it is acknowledged."""
        ...

    def mission_edited(self, mission: Mission) -> None:
        """Fly on by a mission that changes in the middle of an upload (ArduPilot writes in place)."""
        ...

    def jump(self, seq: int) -> bool:
        """Make a mission item current; return whether that is possible."""
        ...

    def current_message(self, seq: int) -> Message:
        """Return a MISSION_CURRENT that names item `seq` (ArduPilot)."""
        ...

    def guide(self, item: MissionItem) -> bool:
        """Fly to an item that is not part of a mission; return False outside GUIDED (ArduPilot)."""
        ...

    def home_item(self) -> MissionItem:
        """Return home as item 0 (ArduPilot)."""
        ...


class MissionProtocol(ABC):
    """Answers mission messages, and holds the plans on board.

    Faults: `refusals` complete uploads are answered MAV_MISSION_ERROR, and `corruptions` uploads are stored with one
    item moved, although they are acknowledged as sound.
    """

    def __init__(self, *, clock: Callable[[], float], host: MissionHost) -> None:
        self.refusals = 0
        self.corruptions = 0
        self._clock = clock
        self._host = host
        self._handlers: dict[str, Callable[[Any, Partner], list[Message]]] = {
            "MISSION_COUNT": self._count,
            "MISSION_ITEM_INT": self._item,
            "MISSION_ITEM": self._float_item,
            "MISSION_REQUEST_LIST": self._request_list,
            "MISSION_REQUEST_INT": self._request,
            "MISSION_REQUEST": self._request,
            "MISSION_ACK": self._ack,
            "MISSION_CLEAR_ALL": self._clear_all,
            "MISSION_SET_CURRENT": self._set_current,
        }

    @property
    def messages(self) -> frozenset[str]:
        """Names of the messages that this protocol answers."""
        return frozenset(self._handlers)

    @property
    def mission(self) -> Mission:
        """The mission on board."""
        return self.plan(MISSION)

    def handle(self, message: Any) -> list[Message]:
        """Return the answers to one incoming mission message."""
        partner = Partner(message.get_srcSystem(), message.get_srcComponent())
        return self._handlers[message.get_type()](message, partner)

    @abstractmethod
    def plan(self, mission_type: int) -> Mission:
        """Return the plan on board of a MAV_MISSION_TYPE."""

    @property
    @abstractmethod
    def busy(self) -> bool:
        """Whether a transfer is under way."""

    @abstractmethod
    def tick(self) -> list[Message]:
        """Return the messages due by now: a repeated request, or the end of a transfer without an answer."""

    @abstractmethod
    def reset(self) -> None:
        """Forget the transfers under way, as a reboot does; the plans on board stay."""

    @abstractmethod
    def _count(self, message: Any, partner: Partner) -> list[Message]: ...

    @abstractmethod
    def _item(self, message: Any, partner: Partner) -> list[Message]: ...

    @abstractmethod
    def _float_item(self, message: Any, partner: Partner) -> list[Message]: ...

    @abstractmethod
    def _request_list(self, message: Any, partner: Partner) -> list[Message]: ...

    @abstractmethod
    def _request(self, message: Any, partner: Partner) -> list[Message]: ...

    @abstractmethod
    def _ack(self, message: Any, partner: Partner) -> list[Message]: ...

    @abstractmethod
    def _clear_all(self, message: Any, partner: Partner) -> list[Message]: ...

    @abstractmethod
    def _set_current(self, message: Any, partner: Partner) -> list[Message]: ...

    def _must_refuse(self) -> bool:
        refused, self.refusals = self.refusals > 0, max(self.refusals - 1, 0)
        return refused

    def _as_stored(self, item: MissionItem, count: int) -> MissionItem:
        """Return the item as it lands in storage: moved, if this upload of `count` items is to be corrupted."""
        if self.corruptions == 0 or item.seq != count - 1:
            return item
        self.corruptions -= 1
        return replace(item, x=max(-(2**31), min(2**31 - 1, item.x + CORRUPTION_E7)))


def ack_message(partner: Partner, result: int, mission_type: int) -> Message:
    """Return a MISSION_ACK."""
    message: Message = dialect.MAVLink_mission_ack_message(*partner, result, mission_type)
    return message


def item_message(partner: Partner, item: MissionItem, mission_type: int, *, current: bool) -> Message:
    """Return a MISSION_ITEM_INT."""
    message: Message = dialect.MAVLink_mission_item_int_message(
        *partner,
        item.seq,
        item.frame,
        item.command,
        int(current),
        item.autocontinue,
        item.param1,
        item.param2,
        item.param3,
        item.param4,
        item.x,
        item.y,
        item.z,
        mission_type,
    )
    return message
