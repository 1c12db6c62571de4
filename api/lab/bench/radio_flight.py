"""One flight of the whole service in virtual time, with base stations that serve, measure and report."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from math import inf
from typing import Any

from skyfolio import sim
from skyfolio.api.common.idempotency import fresh
from skyfolio.api.flights.base_stations import BaseStations, radio_truth
from skyfolio.api.flights.operation import Operation
from skyfolio.api.flights.operation_views import ENDED, OperationView, Policy, State
from skyfolio.api.flights.rates import InForce
from skyfolio.api.lab.virtual.ground import Ground
from skyfolio.api.lab.virtual.loop import run
from skyfolio.api.lab.virtual.stations import GroundPort
from skyfolio.planner import Scenario

STEP_S = 0.25
LIMIT_S = 700.0
STRIKES_AT_S = 31.7
"""Fleet seconds since slot 0 when a UAV falls, in the midst of a slot."""
SOLVE_S = 0.3
"""What a solve takes."""


@dataclass(frozen=True, kw_only=True)
class Case:
    """One flight. channel: the true one; None is what the planner assumes. report: whether base stations report.

    loses: the UAV that falls in mid-slot; faults: what strikes then. link: of every vehicle from slot 0 on, both ways.
    approve_after_s: the operator approves a new plan so late; None: it is flown at once.
    """

    scenario: Scenario
    channel: sim.TruthChannel | None = None
    report: bool = True
    reassociate: bool = True
    loses: str | None = None
    faults: tuple[sim.Fault, ...] = ()
    link: sim.Impairments | None = None
    approve_after_s: float | None = None
    seed: int = 1


@dataclass(frozen=True)
class Flown:
    """How a flight went: its last view, by which plans users were served, and what users truly got, bit/s.

    struck_s: when the UAV fell, fleet seconds since slot 0. refused: how many acknowledgements were refused.
    unacknowledged: the UAVs whose base stations fell behind.
    """

    view: OperationView
    serving: list[InForce]
    rates_bps: list[tuple[float, dict[str, float]]]
    struck_s: float
    refused: int
    unacknowledged: frozenset[str]


def fly(case: Case) -> Flown:
    """Fly a case from take-off to landing."""
    return run(_fly(case))[0]


async def _fly(case: Case) -> Flown:
    settings: dict[str, Any] = {"plan_ahead": False, "reassociate": case.reassociate}
    async with Ground(case.scenario, seed=case.seed, solve_s=lambda _job: SOLVE_S, **settings) as ground:
        service = await ground.start()
        await ground.register()
        record = await ground.ask(service.plans.submit(ground.scenario, fresh("plan")))
        await ground.ask(service.plans.wait(record, 60.0))
        policy: Policy = "auto" if case.approve_after_s is None else "approve"
        operation = await ground.ask(service.operations.start(record.id, policy, fresh("operation")))
        assert isinstance(operation, Operation)  # noqa: S101 - it was made just now
        truth = radio_truth(ground.fleet, case.scenario, case.channel)
        port = GroundPort(ground, operation.id)
        stations = BaseStations(ground.fleet, truth, port, operation.flight.systems, report=case.report, keep=True)
        pilot = _Pilot(case, ground, operation)
        until_s = ground.now_s + LIMIT_S
        while operation.state not in ENDED and ground.now_s < until_s:
            pilot.act()
            await stations.step()
            await asyncio.sleep(STEP_S)
        view = await ground.ask(service.operations.view(operation.id))
        return Flown(
            view=view,
            serving=list(operation.flight.serving),
            rates_bps=stations.log.rates_bps,
            struck_s=pilot.struck_s,
            refused=stations.log.refused,
            unacknowledged=frozenset(
                uav for event in ground.stored_events() for uav in event.data.get("unacknowledged", ())
            ),
        )


class _Pilot:
    """What happens to a flight from outside: the link, the loss, and the operator's approval."""

    def __init__(self, case: Case, ground: Ground, operation: Operation) -> None:
        self._case, self._ground, self._operation = case, ground, operation
        self._asked_s: float | None = None
        self.struck_s = inf

    def act(self) -> None:
        """Do what is due."""
        case, operation = self._case, self._operation
        if operation.state == State.FLYING and case.link is not None:
            self._ground.fleet.impair(up=case.link, down=case.link)
        if self.struck_s == inf and operation.flight.now_s() >= STRIKES_AT_S:
            self.struck_s = operation.flight.now_s()
            for fault in case.faults:
                self._ground.fleet.inject(fault)
            if case.loses is not None:
                self._ground.fleet.inject(sim.Kill(operation.flight.systems[case.loses]))
        self._approve()

    def _approve(self) -> None:
        proposal = self._operation.incidents.proposal
        if proposal is None or self._case.approve_after_s is None:
            return
        self._asked_s = self._ground.now_s if self._asked_s is None else self._asked_s
        if self._ground.now_s >= self._asked_s + self._case.approve_after_s:
            self._operation.incidents.decide(proposal[0], agreed=True)
