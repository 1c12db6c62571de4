"""A recovery that must wait for survivors that do not know where they are, in virtual time."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import Any

from skyfolio.api.flights.journal import Step
from skyfolio.api.flights.recovery import Incident, Recovery
from skyfolio.api.flights.recovery_report import RecoveryReport
from skyfolio.api.lab.virtual.loop import run
from skyfolio.planner import Plan, ReplanError

SLOT_S, SLOTS = 5.0, 20
FOUND_S = 12.0
"""When uav-2 knows its position again."""


class Steps:
    """The log of one incident."""

    number, closed, timings_s = 1, False, {}  # type: ignore[var-annotated]

    def __init__(self) -> None:
        self.taken: list[tuple[float, Step, dict[str, Any]]] = []

    async def step(self, step: Step, **data: Any) -> None:
        self.taken.append((asyncio.get_running_loop().time(), step, data))


class Planning(Recovery):
    """A recovery whose planner refuses everything."""

    async def _plan(self, at_slot: int, *, use_ready: bool) -> Plan:
        del use_ready
        raise ReplanError(f"nothing to fly from slot {at_slot} on")


def recovered(found_s: float, began_s: float = 0.0) -> tuple[RecoveryReport, Steps]:
    """Recover from the loss of uav-3 while the position of uav-2 is unknown until `found_s`."""

    def now_s() -> float:
        return began_s + asyncio.get_running_loop().time()

    def positions_m() -> dict[str, tuple[float, float]]:
        known = {"uav-1": (0.0, 0.0), "uav-3": (90.0, 0.0)}
        return known | ({"uav-2": (50.0, 0.0)} if now_s() >= found_s else {})

    async def recover() -> RecoveryReport:
        flight: Any = SimpleNamespace(
            now_s=now_s, slot_s=SLOT_S, n_slots=SLOTS, positions_m=positions_m, telemetry=lambda _uav: "heard",
            surviving=lambda: ["uav-1", "uav-2"],
            plan=SimpleNamespace(trajectories_m={"uav-1": [], "uav-2": [], "uav-3": []}),
        )  # fmt: skip
        shared: Any = SimpleNamespace(
            settings=SimpleNamespace(guidance_lead_s=1.0), clock=SimpleNamespace(scale=1.0), metrics=Metrics()
        )
        return await Planning(shared, flight, Incident(steps, "heartbeat_lost", {"uav-3": 5.0})).run()  # type: ignore[arg-type]

    steps = Steps()
    return run(recover())[0], steps


class Metrics:
    """Counts nothing."""

    def __getattr__(self, _name: str) -> Any:
        return self

    def __call__(self, *_: object) -> Any:
        return self


def test_a_recovery_waits_until_every_survivor_knows_its_position_again() -> None:
    report, steps = recovered(FOUND_S)
    kinds = [step for _, step, _ in steps.taken]
    assert kinds[:2] == [Step.WAITING, Step.REPLANNED]
    assert steps.taken[0][2] == {"because": "no position of uav-2"}
    at_s, _, data = steps.taken[1]
    assert FOUND_S <= at_s < FOUND_S + 0.5
    assert data["at_slot"] == 3
    assert report.outcome == "failed"  # because of its planner, and not of a position
    assert "nothing to fly" in str(report.error)


def test_a_recovery_begins_at_once_when_every_position_is_known() -> None:
    _, steps = recovered(0.0)
    assert [step for _, step, _ in steps.taken][:1] == [Step.REPLANNED]
    assert steps.taken[0][0] < 1e-3


def test_a_position_that_is_not_found_in_time_ends_the_recovery_as_too_late() -> None:
    report, _ = recovered(1e9, began_s=60.0)
    assert report.outcome == "too_late"
    assert report.error == "no slot is left to fly differently: no position of uav-2"
