"""Several services in virtual time: whose lease has run out sends nothing more, whatever it was about to send."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

import pytest

from skyfolio import sim
from skyfolio.api.common.errors import ConflictError
from skyfolio.api.common.idempotency import fresh
from skyfolio.api.flights.guidance_options import GuidanceOptions
from skyfolio.api.flights.operation import Operation
from skyfolio.api.flights.operation_views import ENDED, State
from skyfolio.api.lab.virtual.ground import Ground
from skyfolio.api.lab.virtual.loop import run
from skyfolio.api.service import Service
from skyfolio.mavlink_bridge.guard import Orders
from skyfolio.mavlink_bridge.guidance import FallBack
from skyfolio.planner import EXAMPLES
from skyfolio.sim.truth import LoggedMessage

THREE = EXAMPLES["paper"]().with_changes(altitude_m=10.0, slots=12)
TERM_S = 2.5
LATENCY_S = 0.1
LATE_S = 0.02 + LATENCY_S
"""A frame that leaves in time is received after the link's latency, and in the step after that."""


def on_ground(work: Callable[[Ground], Awaitable[object]], **options: object) -> None:
    async def carry_out() -> None:
        async with Ground(THREE, seed=5, several=True, **options) as ground:  # type: ignore[arg-type]
            await work(ground)
        assert ground.alive_tasks == []

    run(carry_out())


async def begun(ground: Ground, service: Service, options: GuidanceOptions | None = None) -> Operation:
    """A new operation of this service."""
    await ground.register()
    record = await ground.ask(service.plans.submit(ground.scenario, fresh("plan")), service)
    await ground.ask(service.plans.wait(record, 60.0), service)
    starting = service.operations.start(record.id, "auto", fresh("operation"), options=options)
    operation = await ground.ask(starting, service)
    assert isinstance(operation, Operation)
    return operation


async def so(is_so: Callable[[], object], limit_s: float = 300.0) -> None:
    async with asyncio.timeout(limit_s):
        while not is_so():  # noqa: ASYNC110
            await asyncio.sleep(0.01)


def from_place(ground: Ground, place: int, since_s: float = 0.0) -> list[LoggedMessage]:
    """What any vehicle received from one of the services since then."""
    return [
        message
        for message in ground.fleet.truth.messages
        if message.direction == "in" and message.sender == f"gcs:{place}" and message.t_s > since_s
    ]


def names_of(messages: list[LoggedMessage]) -> set[str]:
    return {message.name for message in messages}


def slow(ground: Ground) -> None:
    """Let an upload take longer than a lease."""
    for system_id in ground.fleet.vehicles:
        way = sim.Impairments(latency_s=LATENCY_S)
        ground.fleet.inject(sim.Impair(system_id, up=way, down=way))


async def uploading(ground: Ground, operation: Operation) -> None:
    slow(ground)
    await so(lambda: "MISSION_ITEM_INT" in names_of(from_place(ground, 0)))
    assert operation.state is State.UPLOADING, operation.error


async def launching(_ground: Ground, operation: Operation) -> None:
    await so(lambda: operation.state is State.LAUNCHING)
    await asyncio.sleep(0.05)


async def flying(_ground: Ground, operation: Operation) -> None:
    await so(lambda: operation.state is State.FLYING)
    await asyncio.sleep(3.0)


async def swapping(ground: Ground, operation: Operation) -> None:
    await flying(ground, operation)
    slow(ground)
    ground.fleet.inject(sim.Kill(3))
    since_s = ground.now_s
    await so(lambda: "MISSION_ITEM_INT" in names_of(from_place(ground, 0, since_s)))
    assert operation.incidents.has_work


SETPOINTS = GuidanceOptions(mode="stream", fall_back=FallBack.HOLD, force_stream=True)


@pytest.mark.parametrize(
    ("moment", "options", "meanwhile"),
    [
        pytest.param(uploading, None, "MISSION_ITEM_INT", id="upload"),
        pytest.param(launching, None, "COMMAND_LONG", id="launch"),
        pytest.param(flying, None, "HEARTBEAT", id="missions"),
        pytest.param(flying, SETPOINTS, "SET_POSITION_TARGET_GLOBAL_INT", id="setpoints"),
        pytest.param(swapping, None, "MISSION_ITEM_INT", id="swap"),
    ],
)
def test_a_service_whose_lease_ran_out_sends_nothing_more(
    moment: Callable[[Ground, Operation], Awaitable[None]], options: GuidanceOptions | None, meanwhile: str
) -> None:
    async def fly(ground: Ground) -> None:
        service = await ground.start()
        operation = await begun(ground, service, options)
        await moment(ground, operation)
        cut_s = ground.now_s
        for line in ground.lines_of(service)[1:]:
            line.cut()  # it renews nothing; what else it stores is still accepted
        await so(lambda: operation.id not in [one.id for one in service.operations.in_the_air])
        left_s = ground.now_s
        await asyncio.sleep(20.0)
        assert left_s <= cut_s + TERM_S + 0.1
        assert meanwhile in names_of(from_place(ground, 0, cut_s - 1.0)), "it was sending this"
        assert from_place(ground, 0, cut_s + TERM_S + LATE_S) == []

    on_ground(fly)


class NotedGuard:
    """Stands in for the guard process, and keeps what it is told."""

    def __init__(self, now_s: Callable[[], float]) -> None:
        self._now_s = now_s
        self.told: list[tuple[float, Orders | None]] = []

    async def start(self) -> None:
        """Begin."""

    def orders(self, orders: Orders | None) -> None:
        self.told.append((self._now_s(), orders))

    async def close(self) -> None:
        """End."""


def test_a_guard_is_told_again_and_again_until_when_it_may_speak_and_never_longer_than_a_term() -> None:
    async def fly(ground: Ground) -> None:
        service, guard = await ground.start(), NotedGuard(lambda: ground.now_s)
        service.fleet.new_guard = lambda: guard
        operation = await begun(ground, service, GuidanceOptions(mode="stream", force_stream=True))
        await flying(ground, operation)
        told = [(told_s, orders.until_s) for told_s, orders in guard.told if orders is not None]
        assert len(told) > 8
        for told_s, until_s in told:
            assert until_s is not None
            assert TERM_S / 2 < until_s - told_s <= TERM_S
        assert told[-1][0] > ground.now_s - TERM_S / 2

    on_ground(fly)


def test_a_stream_ends_in_missions_before_the_lease_runs_out() -> None:
    async def fly(ground: Ground) -> None:
        service = await ground.start()
        service.fleet.new_guard = lambda: NotedGuard(lambda: ground.now_s)
        operation = await begun(ground, service, GuidanceOptions(mode="stream", force_stream=True))
        await flying(ground, operation)
        for line in ground.lines_of(service):
            line.cut()
        await asyncio.sleep(TERM_S + 0.1)
        modes = {vehicle.autopilot.mode.name for vehicle in ground.fleet.vehicles.values()}
        assert modes == {"MISSION"}, "nobody is left waiting for setpoints"

    on_ground(fly)


def modes_of(ground: Ground) -> set[str]:
    return {vehicle.autopilot.mode.name for vehicle in ground.fleet.vehicles.values()}


STREAMED = GuidanceOptions(mode="stream", force_stream=True)


def test_the_guard_of_a_killed_service_starts_missions_while_its_lease_lasts_and_another_service_goes_on() -> None:
    async def fly(ground: Ground) -> None:
        first = await ground.start()
        operation = await begun(ground, first, STREAMED)
        second = await ground.start()
        await flying(ground, operation)
        assert modes_of(ground) == {"GUIDED"}
        killed_s = ground.now_s
        ground.kill(first)
        await so(lambda: modes_of(ground) == {"MISSION"}, TERM_S)
        assert second.operations.active(operation.id) is None
        assert from_place(ground, 1) == [], "the guard of another service is no business of this one"
        await so(lambda: second.operations.active(operation.id))
        taken = second.operations.active(operation.id)
        assert taken is not None
        await so(lambda: taken.state in ENDED)
        assert (taken.state, taken.error) == (State.COMPLETED, None)
        assert max(message.t_s for message in from_place(ground, 0)) <= killed_s + TERM_S + LATE_S
        assert_gapless(ground)

    on_ground(fly)


def test_a_guard_that_nobody_answers_falls_silent_when_the_lease_of_its_service_runs_out() -> None:
    async def fly(ground: Ground) -> None:
        first = await ground.start()
        operation = await begun(ground, first, STREAMED)
        await flying(ground, operation)
        killed_s = ground.now_s
        ground.kill(first)
        await so(lambda: "COMMAND_LONG" in names_of(from_place(ground, 0, killed_s + LATE_S)), TERM_S)
        for system_id in ground.fleet.vehicles:
            ground.fleet.inject(sim.Impair(system_id, down=sim.Impairments(cut=True)))
        deaf_s = ground.now_s
        await asyncio.sleep(20.0)
        last_s = max(message.t_s for message in from_place(ground, 0))
        assert deaf_s + 0.3 < last_s <= killed_s + TERM_S + LATE_S, "it tries again, as long as it may"

    on_ground(fly)


def test_only_the_guard_of_the_service_that_died_speaks_and_from_the_place_of_that_service() -> None:
    async def fly(ground: Ground) -> None:
        services = [await ground.start(), await ground.start()]
        for service in services:
            guard = service.fleet.new_guard()
            await ground.ask(guard.start(), service)
            items = dict.fromkeys(ground.fleet.vehicles, (0, 1, 2))
            guard.orders(Orders(links=service.fleet.links, slot0_at=0.0, scale=1.0, slot_s=5.0, items=items))
        for place in (1, 0):
            assert from_place(ground, place) == []
            ground.kill(services[place])
            await so(lambda place=place: from_place(ground, place))  # type: ignore[misc]

    on_ground(fly)


def test_an_operator_reaches_nobody_through_a_service_whose_lease_ran_out() -> None:
    async def fly(ground: Ground) -> None:
        service = await ground.start()
        operation = await begun(ground, service)
        await flying(ground, operation)
        for line in ground.lines_of(service):
            line.cut()
        await asyncio.sleep(TERM_S + 0.1)
        since_s = ground.now_s
        with pytest.raises(ConflictError, match="belongs to no service now"):
            await ground.ask(service.operations.abort(operation.id, "hold"), service)
        ordering = service.orders.give("hold")
        ordered = asyncio.ensure_future(ground.ask(ordering, service))
        await asyncio.sleep(10.0)
        assert from_place(ground, 0, since_s) == []
        ordered.cancel()

    on_ground(fly)


def test_another_service_goes_on_within_five_seconds_and_the_first_is_silent_before() -> None:
    async def fly(ground: Ground) -> None:
        first = await ground.start()
        operation = await begun(ground, first)
        second = await ground.start()
        await flying(ground, operation)
        assert from_place(ground, 1) == [], "not even a heartbeat"
        cut_s = ground.now_s
        for line in ground.lines_of(first):
            line.cut()
        await so(lambda: second.operations.active(operation.id))
        assert ground.now_s - cut_s < 5.0
        await so(lambda: from_place(ground, 1))
        last_s = max(message.t_s for message in from_place(ground, 0))
        assert last_s <= cut_s + TERM_S + LATE_S
        assert last_s < min(message.t_s for message in from_place(ground, 1))
        await asyncio.sleep(5.0)
        for line in ground.lines_of(first):
            line.mend()
        taken = second.operations.active(operation.id)
        assert taken is not None
        await so(lambda: taken.state in ENDED)
        assert (taken.state, taken.error) == (State.COMPLETED, None)
        assert max(message.t_s for message in from_place(ground, 0)) <= last_s or taken.state in ENDED
        assert_gapless(ground)

    on_ground(fly)


def test_a_killed_service_is_followed_within_five_seconds() -> None:
    async def fly(ground: Ground) -> None:
        first = await ground.start()
        operation = await begun(ground, first)
        second = await ground.start()
        await flying(ground, operation)
        killed_s = ground.now_s
        ground.kill(first)
        await so(lambda: second.operations.active(operation.id))
        assert ground.now_s - killed_s < 5.0
        taken = second.operations.active(operation.id)
        assert taken is not None
        await so(lambda: taken.state in ENDED)
        assert (taken.state, taken.error) == (State.COMPLETED, None)
        assert_gapless(ground)

    on_ground(fly)


def test_a_stopped_service_gives_its_operation_up_at_once() -> None:
    async def fly(ground: Ground) -> None:
        first = await ground.start()
        operation = await begun(ground, first)
        second = await ground.start()
        await flying(ground, operation)
        await ground.stop(first)
        stopped_s = ground.now_s
        await so(lambda: second.operations.active(operation.id))
        assert ground.now_s - stopped_s < 1.0

    on_ground(fly)


def assert_gapless(ground: Ground) -> None:
    """All events of all services have one row of numbers."""
    numbers = [event.id for event in ground.stored_events()]
    assert numbers == list(range(1, len(numbers) + 1))
