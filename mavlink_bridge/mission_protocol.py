"""The ground station's side of the MAVLink mission protocol, without I/O: messages and time in, messages out.

`Upload` offers items with MISSION_COUNT and sends each when it is requested; `Download` reads them back. Both serve all
mission types (0 mission, 1 geofence, 2 rally points) and measure the link's round trip, so that a lost message costs
little more than that. They speak to one vehicle: the caller hands in only what that autopilot (component 1) sent.

If an item is followed neither by the next request nor by an acknowledgement, either the item was lost or the next
request. The item and the next (then the next two) are sent together: PX4 ignores what it has already, ArduPilot answers
INVALID_SEQUENCE and goes on, and both take the one they wait for. So the transfer does not wait for the vehicle's own
timer, 250 ms on PX4 and a second on ArduPilot.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from skyfolio.mavlink_bridge.answers import Ack
from skyfolio.mavlink_bridge.items import MissionItem
from skyfolio.mavlink_bridge.mission_messages import (
    PASSING,
    SILENCE_S,
    Ended,
    Message,
    MissionType,
)
from skyfolio.mavlink_bridge.mission_transfer import Transfer
from skyfolio.mavlink_bridge.round_trip import RoundTrip

MOST_AHEAD = 2
"""The number of items sent beyond the one that was requested."""


class Upload(Transfer):
    """Offers `items` until the vehicle has acknowledged them; no items: clears what it has."""

    def __init__(
        self,
        items: Sequence[MissionItem],
        system_id: int,
        *,
        mission_type: MissionType = MissionType.MISSION,
        round_trip: RoundTrip | None = None,
        silence_s: float = SILENCE_S,
    ) -> None:
        super().__init__(system_id, mission_type, round_trip, silence_s)
        self._items = items
        self._asked_for = -1
        self._ahead = 0
        self._handlers = {
            "MISSION_REQUEST_INT": self._request,
            "MISSION_REQUEST": self._request,
            "MISSION_ACK": self._ack,
        }

    def cancel(self) -> Message:
        """Return the message that ends the transfer on PX4, which would go on with the items of the next one."""
        return self._message("MISSION_ACK", type=int(Ack.OPERATION_CANCELLED))

    def cancel_others(self) -> list[Message]:
        """Return what ends transfers of other types on PX4: the one before goes on there if its last message was lost.

        PX4 refuses all others for 5 s then. What it is not in the middle of, it ignores.
        """
        others = (int(kind) for kind in MissionType if kind is not self._type)
        cancelled = int(Ack.OPERATION_CANCELLED)
        return [self._message("MISSION_ACK", type=cancelled, mission_type=kind) for kind in others]

    def _opening(self) -> Message:
        if not self._items:
            return self._message("MISSION_CLEAR_ALL")
        return self._message("MISSION_COUNT", count=len(self._items))

    def _all_sent(self) -> bool:
        return self._asked_for + self._ahead == len(self._items) - 1

    def _request(self, fields: dict[str, Any], now_s: float) -> list[Message]:
        seq = int(fields["seq"])
        if not 0 <= seq < len(self._items):
            return []
        if seq == self._asked_for + 1:
            self._answered(now_s)
        again = seq == self._asked_for
        first_s, times = self._first_s, self._times
        self._asked_for, self._ahead = seq, 0
        sent = self._ask(self._item(self._items[seq]), now_s)
        if again:
            self._first_s, self._times = first_s, times + 1
        return sent

    def _repeat(self, now_s: float, timeout_s: float) -> list[Message]:
        """Send the item again, and with it the one or two after it (see the module)."""
        repeated = super()._repeat(now_s, timeout_s)
        if self._asked_for < 0:
            return repeated
        self._ahead = min(self._ahead + 1, MOST_AHEAD, len(self._items) - 1 - self._asked_for)
        following = self._items[self._asked_for + 1 : self._asked_for + 1 + self._ahead]
        return repeated + [self._item(item) for item in following]

    def _ack(self, fields: dict[str, Any], now_s: float) -> list[Message]:
        del now_s
        result = Ack(int(fields["type"]))
        started = self._asked_for >= 0
        if result is Ack.ACCEPTED:
            if self._all_sent():  # else it acknowledges another transfer
                self.ended = Ended(opaque_id=int(fields.get("opaque_id", 0)))
        elif self._all_sent() and self._times > 1 and result is Ack.ERROR:  # ArduPilot, which waits for nothing more
            self.ended = Ended(error="the final acknowledgement was lost", perhaps_done=True)
        elif started and result is Ack.INVALID_SEQUENCE:
            pass  # it has what was repeated: the timer goes on
        elif started and result is Ack.DENIED:
            pass  # another station was refused, or we were while the transfer goes on: the timer decides
        else:
            at = f" at item {self._asked_for}" if started else ""
            busy = result is Ack.DENIED  # a started transfer does not come here
            self.ended = Ended(error=f"refused with {result.name}{at}", passing=result in PASSING, busy=busy)
        return []

    def _item(self, item: MissionItem) -> Message:
        values = {name: getattr(item, name) for name in _ITEM_FIELDS}
        values |= {"frame": int(item.frame), "command": int(item.command)}
        return self._message("MISSION_ITEM_INT", **values)


class Download(Transfer):
    """Reads all items of one type; `items` is complete once it has `ended` without an error.

    `window`: the number of items requested at once. PX4 answers only the next one; ArduPilot has no state and answers
    any.
    """

    def __init__(
        self,
        system_id: int,
        *,
        mission_type: MissionType = MissionType.MISSION,
        round_trip: RoundTrip | None = None,
        silence_s: float = SILENCE_S,
        window: int = 1,
    ) -> None:
        super().__init__(system_id, mission_type, round_trip, silence_s)
        self._window = window
        self._read: dict[int, MissionItem] = {}
        self._open: dict[int, tuple[float, float, int]] = {}
        """For each open request: when it was first sent, when last, and how often."""
        self._count: int | None = None
        self._opaque_id = 0
        self._handlers = {
            "MISSION_COUNT": self._counted,
            "MISSION_ITEM_INT": self._item,
            "MISSION_ACK": self._ack,
        }

    @property
    def items(self) -> list[MissionItem]:
        """Return what was read, in order."""
        return [self._read[seq] for seq in sorted(self._read)]

    def _opening(self) -> Message:
        return self._message("MISSION_REQUEST_LIST")

    def _counted(self, fields: dict[str, Any], now_s: float) -> list[Message]:
        if self._count is not None:
            return []
        self._answered(now_s)
        self._count = int(fields["count"])
        self._opaque_id = int(fields.get("opaque_id", 0))
        return self._go_on(now_s)

    def _item(self, fields: dict[str, Any], now_s: float) -> list[Message]:
        seq = int(fields["seq"])
        if seq not in self._open:
            return []
        first_s, _, times = self._open.pop(seq)
        self._round_trip.answered(first_s, now_s, times)
        self._read[seq] = item_from(fields)
        return self._go_on(now_s)

    def _go_on(self, now_s: float) -> list[Message]:
        """Keep `window` requests open; the timer is for the oldest of them."""
        assert self._count is not None  # noqa: S101
        if len(self._read) == self._count:
            self.ended = Ended(opaque_id=self._opaque_id)
            return [self._message("MISSION_ACK", type=int(Ack.ACCEPTED))]
        asked = []
        while len(self._open) < self._window and len(self._read) + len(self._open) < self._count:
            seq = len(self._read) + len(self._open)
            self._open[seq] = (now_s, now_s, 1)
            asked.append(self._request(seq))
        self._asked_s = min(asked_s for _, asked_s, _ in self._open.values())
        return asked

    def _repeat(self, now_s: float, timeout_s: float) -> list[Message]:
        if self._count is None:
            return super()._repeat(now_s, timeout_s)
        overdue = [seq for seq, (_, asked_s, _) in self._open.items() if now_s >= asked_s + timeout_s]
        for seq in overdue:
            first_s, _, times = self._open[seq]
            self._open[seq] = (first_s, now_s, times + 1)
        self._asked_s = min(asked_s for _, asked_s, _ in self._open.values())
        return [self._request(seq) for seq in overdue]

    def _request(self, seq: int) -> Message:
        return self._message("MISSION_REQUEST_INT", seq=seq)

    def _ack(self, fields: dict[str, Any], now_s: float) -> list[Message]:
        """End at a refusal; other acknowledgements are late ones of the upload before."""
        del now_s
        result = Ack(int(fields["type"]))
        if result not in (Ack.ACCEPTED, Ack.INVALID_SEQUENCE, Ack.ERROR):
            self.ended = Ended(error=f"read-back refused with {result.name}", passing=result in PASSING)
        return []


_ITEM_FIELDS = (
    *("seq", "frame", "command", "current", "autocontinue"),
    *("param1", "param2", "param3", "param4", "x", "y", "z"),
)


_FLOATS = ("param1", "param2", "param3", "param4", "z")


def item_from(fields: dict[str, Any]) -> MissionItem:
    """Return a received MISSION_ITEM_INT as an item; a parameter that is NaN is None in JSON."""
    whole = {name: int(fields[name]) for name in _ITEM_FIELDS if name not in _FLOATS}
    floats = {name: float("nan") if fields[name] is None else float(fields[name]) for name in _FLOATS}
    values: dict[str, Any] = {**whole, **floats}
    return MissionItem(**values)
