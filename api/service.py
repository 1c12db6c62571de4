"""The parts of one running service, made and ended together."""

from __future__ import annotations

from api.clock import FleetClock
from api.events import EventLog
from api.fleet import Fleet
from api.operations import Operations
from api.plan_book import PlanBook
from api.settings import Settings
from api.solver import Solver


class Service:
    """Everything a route may use."""

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self.clock = FleetClock(settings.time_scale)
        self.events = EventLog()
        self.solver = Solver(settings.workers, settings.queue_limit)
        self.plans = PlanBook(self.solver, self.events)
        self.fleet = Fleet(settings, self.clock, self.events)
        self.operations = Operations(settings, self.clock, self.events, self.plans, self.fleet)

    async def start(self) -> None:
        """Warm up the solver, so that the first plan is a fast one."""
        await self.solver.warm_up()

    async def stop(self) -> None:
        """End operations (vehicles go on with the mission on board), the link and the workers."""
        await self.operations.close()
        await self.fleet.close()
        await self.plans.close()
        self.solver.close()
