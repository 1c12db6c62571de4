"""Plans made ahead of a loss, in the idle time of an operation in flight."""

from __future__ import annotations

import asyncio

import structlog

from skyfolio.api.flights.flight import Flight
from skyfolio.api.flights.shared_services import SharedServices

log = structlog.get_logger()
SLOTS_AHEAD = 2
"""For how many of the slots that come next plans are made."""
PAUSE_S = 0.2
"""Wall seconds between two rounds."""


class PlansAhead:
    """Makes plans for each single loss at the slots that come next; one round at a time."""

    def __init__(self, flight: Flight, shared: SharedServices, disruption_weight: float) -> None:
        self._flight, self._shared, self._weight = flight, shared, disruption_weight
        self.task: asyncio.Task[None] | None = None
        """The round that is under way, or was last."""

    def go_on(self) -> None:
        """Begin the next round if the last one is over, unless the settings forbid it or one UAV is left."""
        if not self._shared.settings.plan_ahead or len(self._flight.plan.scenario.uavs) < 2:
            return
        if self.task is None or self.task.done():
            self.task = asyncio.create_task(self._make())

    async def _make(self) -> None:
        flight, shared = self._flight, self._shared
        lead_slots = (shared.settings.guidance_lead_s * shared.clock.scale + flight.now_s()) / flight.slot_s
        for at_slot in range(int(lead_slots) + 1, int(lead_slots) + 1 + SLOTS_AHEAD):
            if at_slot < flight.n_slots - 1:
                try:
                    uavs = flight.plan.scenario.uav_ids
                    await shared.contingencies.make(flight.plan, at_slot, uavs, self._weight)
                except Exception as error:  # noqa: BLE001 - what is made in idle time must not end the flight
                    log.warning("no plan was made ahead of a loss", at_slot=at_slot, error=str(error))
                    return
        await asyncio.sleep(PAUSE_S)
