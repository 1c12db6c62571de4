"""The modes that the service commands of one vehicle, and until when it may enter them. Pure, used by `evidence`."""

from __future__ import annotations

from skyfolio.mavlink_bridge.autopilots import FlightMode


class AnnouncedOrders:
    """Orders that are on their way to a vehicle; times are fleet seconds."""

    def __init__(self) -> None:
        self._until_s: dict[FlightMode, float] = {}
        self._latest: tuple[FlightMode, float] | None = None

    def announce(self, modes: frozenset[FlightMode], now_s: float, until_s: float) -> None:
        """Take in that the service commands one of these modes, and that it may be entered until then."""
        for mode in modes:
            self._until_s.pop(mode, None)
            self._until_s[mode] = until_s
            self._latest = (mode, now_s)

    def missed(self, now_s: float, for_s: float) -> None:
        """Take in that nothing was received for so long until now: a change of mode may be seen that much later."""
        for mode, until_s in self._until_s.items():
            if until_s > now_s - for_s:
                self._until_s[mode] = until_s + for_s

    def entered(self, mode: FlightMode, now_s: float) -> bool:
        """Take in a change of mode: return whether it was commanded. Orders before that one are overtaken."""
        if now_s >= self._until_s.get(mode, float("-inf")):
            return False
        orders = list(self._until_s)
        for overtaken in orders[: orders.index(mode)]:
            del self._until_s[overtaken]
        return True

    def latest(self, now_s: float) -> str:
        """Return in words which order was sent last, and when."""
        if self._latest is None:
            return "it sent no order"
        mode, sent_s = self._latest
        return f"its last order was '{mode}' {now_s - sent_s:.1f} s ago"
