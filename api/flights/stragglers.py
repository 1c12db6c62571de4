"""UAVs that still hover when the plan is over, for whatever reason: they are landed, and an event reports it."""

from __future__ import annotations

from math import dist
from typing import TYPE_CHECKING

from skyfolio.mavlink_bridge import OnEnd

if TYPE_CHECKING:
    from skyfolio.api.flights.flight import Flight

STILL_S = 15.0
"""Fleet seconds without moving after which a UAV in the air is not on its way down."""
STILL_M = 1.0
"""Metres; less than this is not moving. A landing sinks faster."""
LOW_M = 1.0
"""Metres above home; a UAV that is lower has landed, and disarms by itself."""


class Stillness:
    """For how long UAVs have not moved; times in fleet seconds, places in metres east, north and up."""

    def __init__(self) -> None:
        self._since: dict[str, tuple[float, tuple[float, float, float]]] = {}

    def seen(self, uav: str, now_s: float, at_m: tuple[float, float, float]) -> bool:
        """Return whether a UAV has not moved for STILL_S; the count then begins again."""
        since_s, there_m = self._since.setdefault(uav, (now_s, at_m))
        if dist(there_m, at_m) > STILL_M:
            self._since[uav] = (now_s, at_m)
            return False
        if now_s - since_s < STILL_S:
            return False
        del self._since[uav]
        return True

    def forget(self, uav: str) -> None:
        """Forget a UAV that is on its way, or not ours to judge."""
        self._since.pop(uav, None)


class Stragglers:
    """The UAVs of a flight after its last slot; `look` is called again and again."""

    def __init__(self) -> None:
        self._stillness = Stillness()

    async def look(self, flight: Flight) -> None:
        """Land UAVs that hover in a mode that we command, or return them if that is how the plan ends.

        Nothing is sent if the plan ends with hovering, nor to a UAV that a human or a failsafe flies.
        """
        if flight.paused or not flight.past_last_slot() or flight.guidance.options.at_end is OnEnd.HOLD:
            return
        hovering = [uav for uav in flight.still_up() if self._hovers(flight, uav)]
        if not hovering:
            return
        home = flight.guidance.options.at_end is OnEnd.RETURN
        for uav, error in (await flight.bring_down(hovering, home=home)).items():
            flight.note(
                "brought_down",
                uav_id=uav,
                level="warning",
                action="return" if home else "land",
                because=f"it hovered for {STILL_S:g} s after the last slot",
                error=error,
            )

    def _hovers(self, flight: Flight, uav: str) -> bool:
        telemetry, at_m = flight.telemetry(uav), flight.roster.last_seen_m(uav)
        if telemetry is None or at_m is None or telemetry.relative_alt_m < LOW_M:
            self._stillness.forget(uav)
            return False
        if not _is_ours(flight, uav):
            self._stillness.forget(uav)
            return False
        return self._stillness.seen(uav, flight.now_s(), (*at_m, telemetry.relative_alt_m))


def _is_ours(flight: Flight, uav: str) -> bool:
    return flight.roster.may_command(uav) and flight.in_our_mode(uav)
