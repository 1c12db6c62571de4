"""The mission protocol, PX4 flavour: a new mission is staged, and replaces the old one only when it is complete.

Messages: MISSION_COUNT, MISSION_REQUEST(_INT), MISSION_ITEM_INT, MISSION_ACK, MISSION_REQUEST_LIST, MISSION_CLEAR_ALL,
MISSION_SET_CURRENT. Time-outs run on the wall (`now_s` of the injected protocol clock), not on fleet time: the ground
station at the other end does not hurry when the simulation does.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as dialect

from sim.missions import MAX_ITEMS, Mission, MissionItem, rejection
from sim.wire import Extended, Message, text

RETRY_S = 0.25
"""PX4 asks again for a missing item after this long."""
GIVE_UP_S = 5.0
"""PX4 ends a transfer in which nothing arrived for this long."""
MISSION = dialect.MAV_MISSION_TYPE_MISSION


class Partner(NamedTuple):
    """Who is at the other end of a transfer."""

    system_id: int
    component_id: int


@dataclass(slots=True)
class _Upload:
    partner: Partner
    count: int
    heard_s: float
    asked_s: float
    staged: list[MissionItem] = field(default_factory=list)


@dataclass(slots=True)
class _Download:
    partner: Partner
    mission: Mission
    heard_s: float


class MissionProtocol:
    """Answers mission messages; owns the mission on board.

    `on_accept(mission)` is called for each complete upload and each clear, before it is acknowledged;
    `on_jump(seq)` for each MISSION_SET_CURRENT to an existing item; `current()` tells the item being flown.
    """

    def __init__(
        self,
        *,
        clock: Callable[[], float],
        on_accept: Callable[[Mission], None],
        on_jump: Callable[[int], object],
        current: Callable[[], int],
    ) -> None:
        self.mission = Mission()
        self._clock = clock
        self._on_accept = on_accept
        self._on_jump = on_jump
        self._current = current
        self._transfer: _Upload | _Download | None = None
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
    def busy(self) -> bool:
        """Whether a transfer is under way."""
        return self._transfer is not None

    @property
    def messages(self) -> frozenset[str]:
        """Names of the messages this protocol answers."""
        return frozenset(self._handlers)

    def handle(self, message: Any) -> list[Message]:
        """Return the answers to one incoming mission message."""
        partner = Partner(message.get_srcSystem(), message.get_srcComponent())
        return self._handlers[message.get_type()](message, partner)

    def tick(self) -> list[Message]:
        """Return what the timers make due: a repeated request, or the end of a silent transfer."""
        transfer, now = self._transfer, self._clock()
        if transfer is None:
            return []
        if now - transfer.heard_s >= GIVE_UP_S:
            self._transfer = None
            return [text("Operation timeout", dialect.MAV_SEVERITY_CRITICAL)]
        if isinstance(transfer, _Upload) and now - transfer.asked_s >= RETRY_S:
            return [self._ask(transfer)]
        return []

    def _count(self, message: Any, partner: Partner) -> list[Message]:
        if message.mission_type != MISSION:
            result = dialect.MAV_MISSION_UNSUPPORTED if message.count else dialect.MAV_MISSION_ACCEPTED
            return [_plain_ack(partner, result, message.mission_type)]
        transfer = self._transfer
        if transfer is not None and transfer.partner != partner:
            return [self._answer(partner, dialect.MAV_MISSION_DENIED)]
        if isinstance(transfer, _Upload) and transfer.staged:
            return []  # busy with these very items: PX4 goes on with them
        if message.count > MAX_ITEMS:
            return [self._end(partner, dialect.MAV_MISSION_NO_SPACE)]
        if message.count == 0:
            return [self._accept(Mission(), partner)]
        now = self._clock()
        self._transfer = _Upload(partner, message.count, heard_s=now, asked_s=now)
        return [self._ask(self._transfer)]

    def _item(self, message: Any, partner: Partner) -> list[Message]:
        if message.mission_type != MISSION:
            return [_plain_ack(partner, dialect.MAV_MISSION_UNSUPPORTED, message.mission_type)]
        transfer = self._transfer
        if not isinstance(transfer, _Upload):
            return [self._late_item(message, partner)]
        if transfer.partner != partner:
            return [self._answer(partner, dialect.MAV_MISSION_DENIED)]
        if message.seq != len(transfer.staged):
            return []
        item = MissionItem.from_message(message)
        refused = rejection(item)
        if refused is not None:
            return [self._end(partner, refused)]
        transfer.staged.append(item)
        transfer.heard_s = self._clock()
        if len(transfer.staged) < transfer.count:
            return [self._ask(transfer)]
        return [self._accept(Mission(tuple(transfer.staged)), partner)]

    def _late_item(self, message: Any, partner: Partner) -> Message:
        """Repeat the acknowledgement only for the very item that completed the mission on board."""
        items = self.mission.items
        known = bool(items) and MissionItem.from_message(message).fingerprint == items[-1].fingerprint
        return self._answer(partner, dialect.MAV_MISSION_ACCEPTED if known else dialect.MAV_MISSION_ERROR)

    def _float_item(self, message: Any, partner: Partner) -> list[Message]:
        return [_plain_ack(partner, dialect.MAV_MISSION_UNSUPPORTED, message.mission_type)]

    def _request_list(self, message: Any, partner: Partner) -> list[Message]:
        if message.mission_type != MISSION:
            return [_count_message(partner, Mission(), message.mission_type)]
        transfer = self._transfer
        if transfer is not None and transfer.partner != partner:
            return [self._answer(partner, dialect.MAV_MISSION_DENIED)]
        if isinstance(transfer, _Upload):
            return []
        self._transfer = _Download(partner, self.mission, heard_s=self._clock()) if self.mission.items else None
        return [_count_message(partner, self.mission, MISSION)]

    def _request(self, message: Any, partner: Partner) -> list[Message]:
        transfer = self._transfer
        if not isinstance(transfer, _Download) or transfer.partner != partner:
            return [self._answer(partner, dialect.MAV_MISSION_DENIED)] if message.mission_type == MISSION else []
        if message.seq >= len(transfer.mission):
            return [self._end(partner, dialect.MAV_MISSION_INVALID_SEQUENCE)]
        transfer.heard_s = self._clock()
        current = transfer.mission is self.mission and message.seq == self._current()
        return [_item_message(partner, transfer.mission.items[message.seq], current=current)]

    def _ack(self, message: Any, partner: Partner) -> list[Message]:
        """Take the end of a download, or the other side's cancellation of either direction."""
        if message.mission_type == MISSION and self._transfer is not None and self._transfer.partner == partner:
            self._transfer = None
        return []

    def _clear_all(self, message: Any, partner: Partner) -> list[Message]:
        everything = message.mission_type == dialect.MAV_MISSION_TYPE_ALL
        if message.mission_type != MISSION and not everything:
            return [_plain_ack(partner, dialect.MAV_MISSION_ACCEPTED, message.mission_type)]
        if self._transfer is not None:
            return [_plain_ack(partner, dialect.MAV_MISSION_DENIED, message.mission_type)]
        self._accept(Mission(), partner)
        return [_plain_ack(partner, dialect.MAV_MISSION_ACCEPTED, message.mission_type)]

    def _set_current(self, message: Any, partner: Partner) -> list[Message]:
        del partner
        if message.seq >= len(self.mission):
            return [text("WPM: WP CURR CMD: Not in list", dialect.MAV_SEVERITY_CRITICAL)]
        self._on_jump(message.seq)
        return []

    def _ask(self, transfer: _Upload) -> Message:
        transfer.asked_s = self._clock()
        request: Message = dialect.MAVLink_mission_request_int_message(*transfer.partner, len(transfer.staged), MISSION)
        return request

    def _accept(self, mission: Mission, partner: Partner) -> Message:
        self.mission = mission
        self._on_accept(mission)
        return self._end(partner, dialect.MAV_MISSION_ACCEPTED)

    def _end(self, partner: Partner, result: int) -> Message:
        self._transfer = None
        return self._answer(partner, result)

    def _answer(self, partner: Partner, result: int) -> Message:
        opaque_id = self.mission.mission_id if result == dialect.MAV_MISSION_ACCEPTED else 0
        return Extended(dialect.MAVLink_mission_ack_message(*partner, result, MISSION), opaque_id=opaque_id)


def _plain_ack(partner: Partner, result: int, mission_type: int) -> Message:
    message: Message = dialect.MAVLink_mission_ack_message(*partner, result, mission_type)
    return message


def _count_message(partner: Partner, mission: Mission, mission_type: int) -> Message:
    base = dialect.MAVLink_mission_count_message(*partner, len(mission), mission_type)
    return Extended(base, opaque_id=mission.mission_id)


def _item_message(partner: Partner, item: MissionItem, *, current: bool) -> Message:
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
        MISSION,
    )
    return message
