"""What can strike in a drill. Each blow is struck at once; what it needs time for is a task of the ground."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Coroutine
from typing import Any

from skyfolio import sim
from skyfolio.api.common.errors import ServiceError
from skyfolio.api.flights.operation import Operation
from skyfolio.api.lab.torture.watch import Seen
from skyfolio.api.service import Service
from skyfolio.api.store import StoreError
from skyfolio.mavlink_bridge import BridgeError

SUPERVISED_S = 2.0
"""Virtual seconds after which a service that has ended by itself is started again."""
Strike = Callable[["Arena", dict[str, Any]], None]


class Arena:
    """Where blows strike: the ground, and what is seen on it."""

    def __init__(self, seen: Seen) -> None:
        self.seen, self.ground = seen, seen.ground
        self.on_restart: Callable[[Service], None] = lambda _service: None
        """Called with each service that is started again."""
        self.tasks: dict[asyncio.Task[None], None] = {}
        self.down = False
        """Whether the service is dead, or not up again yet."""

    def later(self, seconds: float, action: Callable[[], object]) -> None:
        """Do something after so many virtual seconds."""

        async def wait() -> None:
            await asyncio.sleep(seconds)
            action()

        self._spawn(wait())

    def kill(self, down_s: float) -> None:
        """Kill the service; it is started again after so long, and again while it refuses to because the disk is full.

        What supervises a service does so, and one that cannot store what it does must not command vehicles.
        """
        if self.down or self.ground.service is None:
            return
        self.down = True
        self.ground.kill()

        async def restart() -> None:
            await asyncio.sleep(down_s)
            try:
                service = await self._started()
            except Exception as error:  # noqa: BLE001 - whatever it is, the fleet has no service
                self.seen.break_once("a service starts again", f"{type(error).__name__}: {error}")
                return
            self.on_restart(service)
            self.down = False

        self._spawn(restart())

    async def _started(self) -> Service:
        """Start a service, again and again as long as it can store nothing, and return it."""
        while True:
            try:
                return await self.ground.start()
            except StoreError:
                if self.ground.disk.refuses is None:
                    raise
                self.ground.kill()
            await asyncio.sleep(SUPERVISED_S)

    def command(self, work: Callable[[Service], Awaitable[object]]) -> None:
        """Let the operator command something; a refusal is an answer like any other."""

        async def carry_out() -> None:
            service = self.ground.service
            if service is None or self.down:
                return
            try:
                await self.ground.ask(_as_coroutine(work(service)))
            except (ServiceError, BridgeError):
                return
            except asyncio.CancelledError:  # the service was killed meanwhile
                return
            except Exception as error:  # noqa: BLE001 - whatever it is, it is no answer to an operator
                self.seen.break_once("a command is carried out or refused", f"{type(error).__name__}: {error}")

        self._spawn(carry_out())

    def command_each(self, work: Callable[[Service, str], Awaitable[object]]) -> None:
        """Let the operator command the same to each operation, by its id."""
        for one in self.seen.each:
            self.command(lambda service, of=one.operation_id: work(service, of))  # type: ignore[misc]

    def command_operation(self, work: Callable[[Operation], Awaitable[object]], uav: str | None = None) -> None:
        """Let the operator command the operation that a UAV flies, or the first one, if it has not ended."""
        of = next((one.operation_id for one in self.seen.each if uav in one.uavs), self.seen.operation_id)

        async def on(service: Service) -> None:
            operation = service.operations.active(of)
            if operation is not None:
                await work(operation)

        self.command(on)

    def note_orders(self, uavs: list[str] | None = None) -> None:
        """Note that the operator orders these vehicles, or all."""
        ids = self.ground.scenario.uav_ids
        for uav in uavs or ids:
            self.seen.ordered[ids.index(uav) + 1] = self.ground.now_s

    def beside(self, work: Coroutine[Any, Any, None]) -> None:
        """Do something beside the drill, which ends with its operation."""
        self._spawn(work)

    def _spawn(self, work: Any) -> None:
        task = self.ground.spawn(work)
        self.tasks[task] = None
        task.add_done_callback(lambda done: self.tasks.pop(done, None))


async def _as_coroutine(work: Awaitable[object]) -> object:
    return await work


def _vehicle(arena: Arena, options: dict[str, Any]) -> None:
    fault = sim.fault_from(options)
    if fault.system_id in arena.ground.fleet.vehicles:
        arena.ground.fleet.inject(fault)


def _kill_service(arena: Arena, options: dict[str, Any]) -> None:
    arena.kill(options.get("down_s", 1.0))


def _full_disk(arena: Arena, options: dict[str, Any]) -> None:
    disk = arena.ground.disk
    disk.refuses = "database or disk is full"
    arena.later(options.get("for_s", 5.0), lambda: setattr(disk, "refuses", None))


def _slow_disk(arena: Arena, options: dict[str, Any]) -> None:
    disk, before = arena.ground.disk, arena.ground.disk.commit_s
    disk.commit_s = commit_s = options.get("commit_s", 0.5)

    async def recover() -> None:
        await asyncio.sleep(options.get("for_s", 5.0))
        disk.commit_s = min(before, disk.commit_s)
        await asyncio.sleep(commit_s)  # a commit that has just begun is as slow; the drill lasts until it is over

    arena.beside(recover())


def _clock_jump(arena: Arena, options: dict[str, Any]) -> None:
    arena.ground.clock_ahead_s += options.get("seconds", 60.0)


def _dead_workers(arena: Arena, options: dict[str, Any]) -> None:
    workers = arena.ground.workers
    workers.dead = True
    arena.later(options.get("for_s", 5.0), lambda: setattr(workers, "dead", False))


def _pause(arena: Arena, options: dict[str, Any]) -> None:
    arena.note_orders(list(arena.seen.uavs))
    arena.command_operation(lambda operation: operation.pause())
    arena.later(options.get("for_s", 8.0), lambda: arena.command_operation(lambda operation: operation.resume()))


def _abort(arena: Arena, options: dict[str, Any]) -> None:
    arena.note_orders()
    for action in options.get("actions", ["land"]):
        arena.command_each(lambda service, of, action=action: service.operations.abort(of, action))  # type: ignore[misc]


def _order(arena: Arena, options: dict[str, Any]) -> None:
    uavs = options.get("uavs")
    arena.note_orders(uavs)
    arena.command(
        lambda service: service.orders.give(options.get("action", "hold"), uavs, force=options.get("force", False))
    )


def _retire(arena: Arena, options: dict[str, Any]) -> None:
    arena.note_orders([options["uav"]])
    arena.command_operation(lambda operation: operation.retire(options["uav"]), options["uav"])


def _readmit(arena: Arena, options: dict[str, Any]) -> None:
    arena.command_operation(lambda operation: operation.readmit(options["uav"]), options["uav"])


def _decide(arena: Arena, options: dict[str, Any]) -> None:
    async def decide(operation: Operation) -> None:
        operation.incidents.decide(operation.incidents.number, agreed=options.get("agreed", True))

    arena.command_operation(decide)


BLOWS: dict[str, Strike] = {
    "vehicle": _vehicle,
    "kill_service": _kill_service,
    "full_disk": _full_disk,
    "slow_disk": _slow_disk,
    "clock_jump": _clock_jump,
    "dead_workers": _dead_workers,
    "pause": _pause,
    "abort": _abort,
    "order": _order,
    "retire": _retire,
    "readmit": _readmit,
    "decide": _decide,
}
"""What strikes, by name. `vehicle` takes a fault of the simulator as its options (`sim.fault_from`)."""


def name_of(kind: str, options: dict[str, Any]) -> str:
    """Return the name under which a blow is counted."""
    return str(options["kind"]) if kind == "vehicle" else kind
