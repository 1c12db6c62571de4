"""Requests that a plan is extended when that is due, and again in the next slot if that has failed."""

from __future__ import annotations

from skyfolio.api.flights.flight import Flight
from skyfolio.api.flights.incidents import Incidents


class HorizonKeeper:
    """Keeps one flight planned ahead. To be asked in each tick in which a recovery may be begun."""

    def __init__(self, flight: Flight, incidents: Incidents) -> None:
        self._flight, self._incidents = flight, incidents
        self._again_at_slot = 0

    def look(self) -> None:
        """Request an extension if it is due and nothing else is being done: a recovery extends the plan as well."""
        horizon, slot = self._flight.horizon, self._flight.slot()
        if horizon is None or slot is None or slot < self._again_at_slot:
            return
        if self._incidents.has_work or not horizon.is_due():
            return
        self._again_at_slot = slot + 1
        self._incidents.request_recovery("extended", detail=f"{self._flight.n_slots - slot} slots are left")
