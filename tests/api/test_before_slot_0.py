"""Who falls out before slot 0, in virtual time: what happened before the operation was made is history."""

import asyncio
from types import SimpleNamespace
from typing import Any, cast

import pytest

from skyfolio.api.common.fleet_clock import FleetClock
from skyfolio.api.flights.take_off import FlightError, TakeOff
from skyfolio.mavlink_bridge import LinkState
from skyfolio.mavlink_bridge.conditions import Change, Condition
from skyfolio.planner import Plan

MADE_S = 1000.0


class Fleet:
    """One vehicle that stands on the ground, and is seen rebooted as soon as it tells of its clock."""

    def __init__(self, up_s: float) -> None:
        self.link = self.monitor = self
        self.heard_systems = self.watched = frozenset({1})
        self.stale_after_s = 3.0
        self._said = SimpleNamespace(armed=False, heard_at_s=MADE_S + 2.0, boot_ms=round(up_s * 1000))

    def telemetry(self, _system_id: int) -> Any:
        return self._said

    def silent_for_s(self, _system_id: int, _now_s: float) -> float:
        return 0.1

    def state(self, _system_id: int) -> LinkState:
        return LinkState.LIVE

    def condition(self, _system_id: int) -> Change:
        return Change(
            system_id=1, before=Condition.LIVE, after=Condition.REBOOTED, cause="its clock", at_s=MADE_S + 2.0
        )


def take_off(up_s: float) -> TakeOff:
    clock = FleetClock(seconds=lambda: 0.0)
    clock.now = lambda: MADE_S  # type: ignore[method-assign]
    return TakeOff(cast("Plan", None), {"uav-1": 1}, cast("Any", Fleet(up_s)), clock, cast("Any", None))


async def test_one_that_was_switched_off_and_on_before_may_fly() -> None:
    assert await take_off(up_s=70.2).watched(asyncio.sleep(0, "done")) == "done"


async def test_one_that_restarts_meanwhile_ends_it() -> None:
    with pytest.raises(FlightError, match="'uav-1': rebooted: its clock"):
        await take_off(up_s=1.5).watched(asyncio.sleep(1))
