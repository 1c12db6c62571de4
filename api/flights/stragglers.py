"""Whoever still hovers when the plan is over, for whatever reason: it is brought down, and an event says so."""

from __future__ import annotations

from math import dist
from typing import TYPE_CHECKING

from skyfolio.mavlink_bridge import OnEnd, Telemetry
from skyfolio.mavlink_bridge.autopilots import OURS

if TYPE_CHECKING:
    from skyfolio.api.flights.flight import Flight

STILL_S = 15.0
"""Fleet seconds without moving after which a UAV in the air is not on its way down any more."""
STILL_M = 1.0
"""Less than this is not moving; a landing sinks faster."""
LOW_M = 1.0
"""Lower than this it has landed, and disarms by itself."""


class Stillness:
    """For how long UAVs have been where they are; times are fleet seconds, places metres east, north and up."""

    def __init__(self) -> None:
        self._since: dict[str, tuple[float, tuple[float, float, float]]] = {}

    def seen(self, uav: str, now_s: float, at_m: tuple[float, float, float]) -> bool:
        """Whether it has not moved for STILL_S; then it is counted anew."""
        since_s, there_m = self._since.setdefault(uav, (now_s, at_m))
        if dist(there_m, at_m) > STILL_M:
            self._since[uav] = (now_s, at_m)
            return False
        if now_s - since_s < STILL_S:
            return False
        del self._since[uav]
        return True

    def forget(self, uav: str) -> None:
        """It is on its way, or not ours to judge."""
        self._since.pop(uav, None)


class Stragglers:
    """The UAVs of a flight after its last slot; `look` is called again and again."""

    def __init__(self) -> None:
        self._stillness = Stillness()

    async def look(self, flight: Flight) -> None:
        """Land, or return where that is the plan's end, who hovers in a mode of ours; by plan hovering is left alone.

        One that a human or a failsafe flies is never told anything.
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
        said, at_m = flight.telemetry(uav), flight.roster.last_seen_m(uav)
        if said is None or at_m is None or said.relative_alt_m < LOW_M or not _is_ours(flight, uav, said):
            self._stillness.forget(uav)
            return False
        return self._stillness.seen(uav, flight.now_s(), (*at_m, said.relative_alt_m))


def _is_ours(flight: Flight, uav: str, said: Telemetry) -> bool:
    return flight.roster.may_command(uav) and said.mode in OURS[flight.autopilot(uav)]
