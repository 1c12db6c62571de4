"""The mission protocol, PX4 flavour: a new plan is staged, and replaces the old one only when it is complete.

One transfer at a time, whatever its type. A missing item is requested again every 250 ms; after 5 s without a
message the transfer ends, with a STATUSTEXT but without a MISSION_ACK.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.sim.mission_protocol import (
    ALL,
    MISSION,
    TYPES,
    MissionHost,
    MissionProtocol,
    Partner,
    ack_message,
    item_message,
)
from skyfolio.sim.missions import Mission, MissionItem, bad_fence, rejection
from skyfolio.sim.px4_storage import as_read
from skyfolio.sim.wire import Extended, Message, text

RETRY_S = 0.25
"""PX4 requests a missing item again after this long."""
GIVE_UP_S = 5.0
"""PX4 ends a transfer without a message for this long."""
MAX_ITEMS = 500


@dataclass(slots=True)
class _Upload:
    partner: Partner
    type: int
    count: int
    last_message_s: float
    requested_s: float
    staged: list[MissionItem] = field(default_factory=list)


@dataclass(slots=True)
class _Download:
    partner: Partner
    type: int
    plan: Mission
    last_message_s: float


class Px4Missions(MissionProtocol):
    """Always holds complete, accepted plans."""

    def __init__(self, *, clock: Callable[[], float], host: MissionHost) -> None:
        super().__init__(clock=clock, host=host)
        self._plans = dict.fromkeys(TYPES, Mission())
        self._transfer: _Upload | _Download | None = None

    @property
    def busy(self) -> bool:
        """Whether a transfer is under way."""
        return self._transfer is not None

    def plan(self, mission_type: int) -> Mission:
        """Return the plan on board of a MAV_MISSION_TYPE."""
        return self._plans[mission_type]

    def reset(self) -> None:
        """Forget the transfer under way."""
        self._transfer = None

    def tick(self) -> list[Message]:
        """Return the messages due by now: a repeated request, or the end of a transfer without an answer."""
        transfer, now = self._transfer, self._clock()
        if transfer is None:
            return []
        if now - transfer.last_message_s >= GIVE_UP_S:
            self._transfer = None
            return [text("Operation timeout", dialect.MAV_SEVERITY_CRITICAL)]
        if isinstance(transfer, _Upload) and now - transfer.requested_s >= RETRY_S:
            return [self._request_item(transfer)]
        return []

    def _count(self, message: Any, partner: Partner) -> list[Message]:
        kind = message.mission_type
        if kind not in TYPES:
            return [ack_message(partner, dialect.MAV_MISSION_UNSUPPORTED, kind)]
        transfer = self._transfer
        if transfer is not None and (transfer.partner, transfer.type) != (partner, kind):
            return [self._answer(partner, dialect.MAV_MISSION_DENIED, kind)]
        if isinstance(transfer, _Upload) and transfer.staged:
            return []  # busy with these very items: PX4 goes on with them
        if message.count > MAX_ITEMS:
            return [self._end(partner, dialect.MAV_MISSION_NO_SPACE, kind)]
        if message.count == 0:
            return [self._accept(Mission(), partner, kind)]
        now = self._clock()
        self._transfer = _Upload(partner, kind, message.count, last_message_s=now, requested_s=now)
        return [self._request_item(self._transfer)]

    def _item(self, message: Any, partner: Partner) -> list[Message]:
        kind = message.mission_type
        if kind not in TYPES:
            return [ack_message(partner, dialect.MAV_MISSION_UNSUPPORTED, kind)]
        transfer = self._transfer
        if not isinstance(transfer, _Upload):
            return [self._late_item(message, partner)]
        if (transfer.partner, transfer.type) != (partner, kind):
            return [self._answer(partner, dialect.MAV_MISSION_DENIED, kind)]
        if message.seq != len(transfer.staged):
            return []
        item = MissionItem.from_message(message)
        refused = rejection(item, kind)
        if refused is not None:
            return [self._end(partner, refused, kind)]
        transfer.staged.append(self._as_stored(item, transfer.count))
        transfer.last_message_s = self._clock()
        if len(transfer.staged) < transfer.count:
            return [self._request_item(transfer)]
        return [self._complete(tuple(transfer.staged), partner, kind)]

    def _complete(self, items: tuple[MissionItem, ...], partner: Partner, kind: int) -> Message:
        if self._must_refuse() or (kind == dialect.MAV_MISSION_TYPE_FENCE and bad_fence(items)):
            return self._end(partner, dialect.MAV_MISSION_ERROR, kind)
        return self._accept(Mission(items), partner, kind)

    def _late_item(self, message: Any, partner: Partner) -> Message:
        """Return the acknowledgement again, but only for the item that completed the plan on board."""
        items = self._plans[message.mission_type].items
        is_last = bool(items) and MissionItem.from_message(message).fingerprint == items[-1].fingerprint
        result = dialect.MAV_MISSION_ACCEPTED if is_last else dialect.MAV_MISSION_ERROR
        return self._answer(partner, result, message.mission_type)

    def _float_item(self, message: Any, partner: Partner) -> list[Message]:
        return [ack_message(partner, dialect.MAV_MISSION_UNSUPPORTED, message.mission_type)]

    def _request_list(self, message: Any, partner: Partner) -> list[Message]:
        kind, transfer = message.mission_type, self._transfer
        if kind not in TYPES:
            return [ack_message(partner, dialect.MAV_MISSION_UNSUPPORTED, kind)]
        if transfer is not None and transfer.partner != partner:
            return [self._answer(partner, dialect.MAV_MISSION_DENIED, kind)]
        if isinstance(transfer, _Upload):
            return []
        plan = self._plans[kind]
        self._transfer = _Download(partner, kind, plan, last_message_s=self._clock()) if plan.items else None
        base = dialect.MAVLink_mission_count_message(*partner, len(plan), kind)
        return [Extended(base, opaque_id=plan.mission_id)]

    def _request(self, message: Any, partner: Partner) -> list[Message]:
        kind, transfer = message.mission_type, self._transfer
        if not isinstance(transfer, _Download) or (transfer.partner, transfer.type) != (partner, kind):
            return [self._answer(partner, dialect.MAV_MISSION_DENIED, kind)] if kind in TYPES else []
        if message.seq >= len(transfer.plan):
            return [self._end(partner, dialect.MAV_MISSION_INVALID_SEQUENCE, kind)]
        transfer.last_message_s = self._clock()
        current = kind == MISSION and transfer.plan is self.mission and message.seq == self._host.mission_index
        return [item_message(partner, as_read(transfer.plan.items[message.seq], kind), kind, current=current)]

    def _ack(self, message: Any, partner: Partner) -> list[Message]:
        """End a download, or a transfer of either direction that the other side cancels."""
        transfer = self._transfer
        if transfer is not None and (transfer.partner, transfer.type) == (partner, message.mission_type):
            self._transfer = None
        return []

    def _clear_all(self, message: Any, partner: Partner) -> list[Message]:
        kind = message.mission_type
        if kind not in (*TYPES, ALL):
            return [ack_message(partner, dialect.MAV_MISSION_UNSUPPORTED, kind)]
        if self._transfer is not None:
            return [ack_message(partner, dialect.MAV_MISSION_DENIED, kind)]
        for cleared in TYPES if kind == ALL else (kind,):
            self._accept(Mission(), partner, cleared)
        return [ack_message(partner, dialect.MAV_MISSION_ACCEPTED, kind)]

    def _set_current(self, message: Any, partner: Partner) -> list[Message]:
        del partner
        if not self._host.jump(message.seq):
            return [text("WPM: WP CURR CMD: Not in list", dialect.MAV_SEVERITY_CRITICAL)]
        return []

    def _request_item(self, transfer: _Upload) -> Message:
        transfer.requested_s = self._clock()
        seq = len(transfer.staged)
        request: Message = dialect.MAVLink_mission_request_int_message(*transfer.partner, seq, transfer.type)
        return request

    def _accept(self, plan: Mission, partner: Partner, kind: int) -> Message:
        self._plans[kind] = plan
        self._host.plan_accepted(kind, plan)
        return self._end(partner, dialect.MAV_MISSION_ACCEPTED, kind)

    def _end(self, partner: Partner, result: int, kind: int) -> Message:
        self._transfer = None
        return self._answer(partner, result, kind)

    def _answer(self, partner: Partner, result: int, kind: int) -> Message:
        opaque_id = self._plans[kind].mission_id if result == dialect.MAV_MISSION_ACCEPTED else 0
        return Extended(dialect.MAVLink_mission_ack_message(*partner, result, kind), opaque_id=opaque_id)
