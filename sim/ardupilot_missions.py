"""The mission protocol, ArduPilot flavour: MISSION_COUNT truncates what is on board, and items are written in place.

A broken upload therefore leaves a hybrid of the old and the new mission. Item 0 is home: whatever is uploaded there,
home is read back. Storage keeps only what ArduCopter needs (`sim.ardupilot_storage`).

A missing item is requested again after 1 s (with MISSION_REQUEST, as ArduPilot does), and after 8 s without one the
transfer ends with MAV_MISSION_OPERATION_CANCELLED. MISSION_ACK from a ground station is ignored; items out of order
and items from other senders are answered INVALID_SEQUENCE and DENIED and do not end the transfer, a refused item does.
Fences are staged until they are whole, rally points are not.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.sim.ardupilot_storage import as_stored
from skyfolio.sim.mission_protocol import (
    MISSION,
    TYPES,
    MissionHost,
    MissionProtocol,
    Partner,
    ack_message,
    item_message,
)
from skyfolio.sim.missions import Mission, MissionItem, bad_fence, rejection
from skyfolio.sim.wire import Message, text

RETRY_S = 1.0
GIVE_UP_S = 8.0
MAX_ITEMS = 724
"""How many items fit in the storage of a common flight controller (15 bytes each)."""
HIGHEST_M = 83_000.0
FENCE = dialect.MAV_MISSION_TYPE_FENCE
_GUIDED_TARGET, _GUIDED_ALTITUDE = 2, 3
"""MISSION_ITEM.current of an item that is not part of a mission but a target in GUIDED mode."""


@dataclass(slots=True)
class _Upload:
    partner: Partner
    next: int
    last: int
    last_item_s: float
    requested_s: float
    staged: list[MissionItem] = field(default_factory=list)


class ArdupilotMissions(MissionProtocol):
    """Holds the items written last, one by one; each plan type has transfers of its own."""

    def __init__(self, *, clock: Callable[[], float], host: MissionHost) -> None:
        super().__init__(clock=clock, host=host)
        self._stored: dict[int, list[MissionItem]] = {kind: [] for kind in TYPES}
        self._plans = dict.fromkeys(TYPES, Mission())
        self._uploads: dict[int, _Upload] = {}
        self._handlers["MISSION_WRITE_PARTIAL_LIST"] = self._write_partial_list

    @property
    def busy(self) -> bool:
        """Whether an upload is under way; downloads have no state here."""
        return bool(self._uploads)

    def plan(self, mission_type: int) -> Mission:
        """Return the plan on board of a MAV_MISSION_TYPE."""
        return self._plans[mission_type]

    def reset(self) -> None:
        """Forget the uploads under way; the items that they wrote stay."""
        self._uploads.clear()

    def tick(self) -> list[Message]:
        """Return the messages due by now: repeated requests, and the end of uploads without an item for too long."""
        now, due = self._clock(), []
        for kind, upload in list(self._uploads.items()):
            if now - upload.last_item_s > GIVE_UP_S:
                del self._uploads[kind]
                due.append(text("Mission upload timeout", dialect.MAV_SEVERITY_WARNING))
                due.append(ack_message(upload.partner, dialect.MAV_MISSION_OPERATION_CANCELLED, kind))
            elif now - upload.requested_s > RETRY_S:
                due.append(self._request_item(upload, kind))
        return due

    def _count(self, message: Any, partner: Partner) -> list[Message]:
        kind = message.mission_type
        if kind not in TYPES:
            return [ack_message(partner, dialect.MAV_MISSION_UNSUPPORTED, kind)]
        if kind in self._uploads and self._uploads[kind].partner != partner:
            return [ack_message(partner, dialect.MAV_MISSION_DENIED, kind)]
        if message.count > MAX_ITEMS:
            words = text(f"Only {MAX_ITEMS} items are supported", dialect.MAV_SEVERITY_WARNING)
            return [ack_message(partner, dialect.MAV_MISSION_NO_SPACE, kind), words]
        if kind != FENCE:
            self._truncate(kind, message.count)
        if message.count == 0:
            return self._complete(kind, partner, [])
        return [self._begin(kind, partner, 0, message.count - 1)]

    def _write_partial_list(self, message: Any, partner: Partner) -> list[Message]:
        kind, start, end = message.mission_type, message.start_index, message.end_index
        if kind not in TYPES:
            return [ack_message(partner, dialect.MAV_MISSION_UNSUPPORTED, kind)]
        if kind == FENCE or not 0 <= start <= end <= len(self._stored[kind]):
            return [ack_message(partner, dialect.MAV_MISSION_ERROR, kind)]
        return [self._begin(kind, partner, start, end)]

    def _begin(self, kind: int, partner: Partner, first: int, last: int) -> Message:
        now = self._clock()
        self._uploads[kind] = _Upload(partner, first, last, last_item_s=now, requested_s=now)
        return self._request_item(self._uploads[kind], kind)

    def _float_item(self, message: Any, partner: Partner) -> list[Message]:
        return self._take(MissionItem.from_float_message(message), message, partner)

    def _item(self, message: Any, partner: Partner) -> list[Message]:
        return self._take(MissionItem.from_message(message), message, partner)

    def _take(self, item: MissionItem, message: Any, partner: Partner) -> list[Message]:
        kind = message.mission_type
        if kind == MISSION and item.current in (_GUIDED_TARGET, _GUIDED_ALTITUDE):
            is_flown = self._host.guide(item)
            return [ack_message(partner, dialect.MAV_MISSION_ACCEPTED if is_flown else dialect.MAV_MISSION_ERROR, kind)]
        upload = self._uploads.get(kind)
        if upload is None:
            return [ack_message(partner, dialect.MAV_MISSION_ERROR, kind)]
        if item.seq != upload.next:
            return [ack_message(partner, dialect.MAV_MISSION_INVALID_SEQUENCE, kind)]
        if upload.partner != partner:
            return [ack_message(partner, dialect.MAV_MISSION_DENIED, kind)]
        refused = self._write(item, kind, upload)
        if refused is not None:
            del self._uploads[kind]
            return [ack_message(partner, refused, kind)]
        upload.last_item_s = self._clock()
        upload.next += 1
        if upload.next <= upload.last:
            return [self._request_item(upload, kind)]
        return self._complete(kind, partner, upload.staged)

    def _write(self, item: MissionItem, kind: int, upload: _Upload) -> int | None:
        """Store an item; return the MAV_MISSION_RESULT that refuses it, or None."""
        stored, refused = self._stored[kind], rejection(item, kind)
        if refused is None and abs(item.z) > HIGHEST_M:
            refused = int(dialect.MAV_MISSION_INVALID_PARAM7)
        if refused is not None:
            return refused
        if kind == FENCE:
            upload.staged.append(as_stored(item, kind))
            return None
        if item.seq > len(stored):
            return int(dialect.MAV_MISSION_ERROR)
        stored[item.seq : item.seq + 1] = [self._as_stored(as_stored(item, kind), upload.last + 1)]
        self._edited(kind)
        return None

    def _truncate(self, kind: int, count: int) -> None:
        if count < len(self._stored[kind]):
            del self._stored[kind][count:]
            self._edited(kind)

    def _edited(self, kind: int) -> None:
        self._plans[kind] = Mission(tuple(self._stored[kind]))
        if kind == MISSION:
            self._host.mission_edited(self._plans[kind])

    def _complete(self, kind: int, partner: Partner, staged: list[MissionItem]) -> list[Message]:
        self._uploads.pop(kind, None)
        if self._must_refuse() or (kind == FENCE and bad_fence(tuple(staged))):
            return [ack_message(partner, dialect.MAV_MISSION_ERROR, kind)]
        if kind == FENCE:
            self._stored[kind] = staged
            self._edited(kind)
        self._host.plan_accepted(kind, self._plans[kind])
        words = [text("Flight plan received")] if kind == MISSION else []
        return [*words, ack_message(partner, dialect.MAV_MISSION_ACCEPTED, kind)]

    def _request_list(self, message: Any, partner: Partner) -> list[Message]:
        kind = message.mission_type
        refused = self._cannot_read(kind, partner)
        if refused:
            return refused
        count: Message = dialect.MAVLink_mission_count_message(*partner, len(self._stored[kind]), kind)
        return [count]

    def _request(self, message: Any, partner: Partner) -> list[Message]:
        kind = message.mission_type
        refused = self._cannot_read(kind, partner)
        if refused:
            return refused
        if message.seq >= len(self._stored[kind]):
            return [ack_message(partner, dialect.MAV_MISSION_INVALID_SEQUENCE, kind)]
        item = self._stored[kind][message.seq]
        if kind == MISSION and item.seq == 0:
            item = self._host.home_item()
        current = kind == MISSION and item.seq == self._host.mission_index
        if message.get_type() == "MISSION_REQUEST":
            return [_float_item_message(partner, item, kind, current=current)]
        return [item_message(partner, item, kind, current=current)]

    def _cannot_read(self, kind: int, partner: Partner) -> list[Message]:
        if kind not in TYPES:
            return [ack_message(partner, dialect.MAV_MISSION_UNSUPPORTED, kind)]
        return [ack_message(partner, dialect.MAV_MISSION_DENIED, kind)] if kind in self._uploads else []

    def _ack(self, message: Any, partner: Partner) -> list[Message]:
        del message, partner
        return []

    def _clear_all(self, message: Any, partner: Partner) -> list[Message]:
        kind = message.mission_type
        if kind not in TYPES:
            return [ack_message(partner, dialect.MAV_MISSION_UNSUPPORTED, kind)]
        if kind in self._uploads or (kind == MISSION and self._host.mission_running):
            return [ack_message(partner, dialect.MAV_MISSION_ERROR, kind)]
        self._stored[kind] = []
        self._edited(kind)
        self._host.plan_accepted(kind, self._plans[kind])
        return [ack_message(partner, dialect.MAV_MISSION_ACCEPTED, kind)]

    def _set_current(self, message: Any, partner: Partner) -> list[Message]:
        """Jump to an item and return the MISSION_CURRENT that names it; nothing if there is no such item."""
        del partner
        return [self._host.current_message(message.seq)] if self._host.jump(message.seq) else []

    def _request_item(self, upload: _Upload, kind: int) -> Message:
        upload.requested_s = self._clock()
        request: Message = dialect.MAVLink_mission_request_message(*upload.partner, upload.next, kind)
        return request


def _float_item_message(partner: Partner, item: MissionItem, kind: int, *, current: bool) -> Message:
    head = (item.seq, item.frame, item.command, int(current), item.autocontinue)
    params = (item.param1, item.param2, item.param3, item.param4)
    message: Message = dialect.MAVLink_mission_item_message(
        *partner, *head, *params, item.x / 1e7, item.y / 1e7, item.z, kind
    )
    return message
