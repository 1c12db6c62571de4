"""The guard of a stream: a process of its own that starts the vehicles' missions if the streaming one dies.

No autopilot flies its mission by itself when setpoints end: PX4 holds after COM_OF_LOSS_T, ArduCopter stops after
GUID_TIMEOUT. So while vehicles with that policy are streamed to, a small process waits at the end of a pipe, which
breaks however the other process ends. Then the guard opens the same links, makes the waypoint of the current slot
current in each vehicle that is still ours, sees it fly its mission, and ends. A service that has already been restarted
holds the links, and is then responsible for the vehicles.

    python -m skyfolio.mavlink_bridge.guard      orders as JSON on standard input, one a line; `null`: nothing to guard
"""

from __future__ import annotations

import asyncio
import json
import logging
import signal
import sys
import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path

from skyfolio.mavlink_bridge.errors import ConnectionFailed, GuardFailed, VehiclesMissing
from skyfolio.mavlink_bridge.guidance import FallBack, let_go, next_slot
from skyfolio.mavlink_bridge.heartbeat import HeartbeatMonitor
from skyfolio.mavlink_bridge.hub import LinkOptions
from skyfolio.mavlink_bridge.link import FleetLink
from skyfolio.mavlink_bridge.ports import LinkPorts
from skyfolio.mavlink_bridge.signing import Signing
from skyfolio.mavlink_bridge.vehicle import Clock

READY = b"guarding\n"
"""What the process prints once it can take orders."""
LINKS_FREE_S = 3.0
"""Wall seconds until the links of a killed process are free; if they are taken later, somebody else has them."""
HEARD_S = 5.0
TRIES = 3
AT_MOST_S = 15.0
"""Wall seconds for which the links are kept from a service that is started again, which waits for them no longer than
20 s: a vehicle that has not followed by then is left to it."""
_LOGGER = logging.getLogger("skyfolio.mavlink_bridge.guard")


@dataclass(frozen=True, kw_only=True)
class Orders:
    """What to do when the pipe breaks.

    links: URLs (see `endpoints`). slot0_at: UTC seconds when slot 0 began. slot_s: fleet seconds a slot; scale: fleet
    seconds a wall second. items: for each system id the seq of the waypoint at which it is when a slot begins, for
    each slot (`Mission.item_of_slot`). signing_key_file: never the key itself. until_s: the second of this machine's
    CLOCK_BOOTTIME from which on another service may command the vehicles, and nothing more is sent; None: never.
    """

    links: tuple[str, ...]
    slot0_at: float
    scale: float
    slot_s: float
    items: Mapping[int, tuple[int, ...]]
    signing_key_file: str | None = None
    until_s: float | None = None

    def are_valid(self, boot_s: float) -> bool:
        """Return whether the vehicles are this machine's to command at that second of its CLOCK_BOOTTIME."""
        return self.until_s is None or boot_s < self.until_s

    def item_at(self, system_id: int, now: float) -> int:
        """Return the waypoint to fly to at UTC second `now`: that of the slot that begins next, at most the last."""
        items = self.items[system_id]
        return items[next_slot((now - self.slot0_at) * self.scale, self.slot_s, len(items) - 1)]

    def line(self) -> bytes:
        """Return the orders as one line of JSON."""
        return json.dumps(asdict(self)).encode() + b"\n"

    @classmethod
    def of_line(cls, line: bytes) -> Orders | None:
        """Return the orders that `line` wrote; None for `null`."""
        document = json.loads(line)
        if document is None:
            return None
        items = {int(system_id): tuple(seqs) for system_id, seqs in document["items"].items()}
        return cls(**{**document, "links": tuple(document["links"]), "items": items})


class Guard:
    """This process's side of the pipe.

    guard = Guard()
    await guard.start()         # raises GuardFailed
    guard.orders(Orders(...))   # from now on vehicles go on without us
    guard.orders(None)          # nothing to guard
    await guard.close()
    """

    def __init__(self) -> None:
        self._process: asyncio.subprocess.Process | None = None

    async def start(self, timeout_s: float = 20.0) -> None:
        """Begin the process; it outlives a signal to this one's group. Raises GuardFailed."""
        if self._process is not None and self._process.returncode is None:
            return
        pipe = asyncio.subprocess.PIPE
        self._process = await asyncio.create_subprocess_exec(
            sys.executable, "-m", __name__, stdin=pipe, stdout=pipe, start_new_session=True
        )
        assert self._process.stdout is not None  # noqa: S101
        try:
            async with asyncio.timeout(timeout_s):
                printed = await self._process.stdout.readline()
        except TimeoutError:
            printed = b""
        if printed != READY:
            await self.close()
            raise GuardFailed(f"the guard process did not begin within {timeout_s:g} s")

    def orders(self, orders: Orders | None) -> None:
        """Set what to do if this process dies, from now on. Raises GuardFailed if the guard process has ended."""
        process = self._process
        if process is None or process.returncode is not None or process.stdin is None:
            raise GuardFailed("the guard process is gone")
        process.stdin.write(b"null\n" if orders is None else orders.line())

    async def close(self) -> None:
        """End the guard process; it does nothing else."""
        process, self._process = self._process, None
        if process is None or process.stdin is None:
            return
        with suppress(ConnectionError):
            process.stdin.write(b"null\n")
            process.stdin.close()
            await process.stdin.wait_closed()
        await process.wait()


class _Wall:
    def now(self) -> float:
        return time.monotonic()


def _boot_s() -> float:
    return time.clock_gettime(time.CLOCK_BOOTTIME)


async def take_over(
    orders: Orders,
    *,
    ports: LinkPorts | None = None,
    clock: Clock | None = None,
    utc_s: Callable[[], float] = time.time,
    boot_s: Callable[[], float] = _boot_s,
) -> dict[int, str | None]:
    """Start the mission of every vehicle; return for each what went wrong, or None. Raises ConnectionFailed.

    Once `orders` are no longer valid nothing is sent. ports, clock (wall seconds), utc_s and boot_s (seconds of
    CLOCK_BOOTTIME): what it reaches the world through; those of a process by default.
    """
    key = orders.signing_key_file
    options = LinkOptions(
        signing=Signing.from_file(Path(key)) if key is not None else None,
        may_send=None if orders.until_s is None else lambda _system_id: orders.are_valid(boot_s()),
    )
    link = FleetLink(clock=clock or _Wall(), monitor=HeartbeatMonitor(), options=options, ports=ports)
    async with link:
        for url in orders.links:
            await link.connect(url, patience_s=LINKS_FREE_S)
        failures = await asyncio.gather(*(_one(link, orders, system_id, utc_s) for system_id in orders.items))
    return dict(zip(orders.items, failures, strict=True))


async def _one(link: FleetLink, orders: Orders, system_id: int, utc_s: Callable[[], float]) -> str | None:
    error: str | None = f"not done within {AT_MOST_S:g} s"
    with suppress(TimeoutError):
        async with asyncio.timeout(AT_MOST_S):
            try:
                await link.wait_for({system_id}, timeout_s=HEARD_S)
            except VehiclesMissing:
                return f"not heard within {HEARD_S:g} s"
            for _ in range(TRIES):
                error = await let_go(link.vehicle(system_id), orders.item_at(system_id, utc_s()), FallBack.MISSION)
                if error is None:
                    break
    return error


def last_of(lines: Iterable[bytes]) -> Orders | None:
    """Return the last complete orders before the pipe broke."""
    orders = None
    for line in lines:
        with suppress(ValueError, TypeError, KeyError):  # half a line: the process died as it wrote it
            orders = Orders.of_line(line)
    return orders


def main() -> None:
    """Wait until the pipe breaks, then do as ordered; return the exit status."""
    for number in (signal.SIGINT, signal.SIGTERM):  # it ends with the pipe, and not before its task is done
        signal.signal(number, signal.SIG_IGN)
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(name)s %(levelname)s %(message)s")
    sys.stdout.buffer.write(READY)
    sys.stdout.buffer.flush()
    orders = last_of(sys.stdin.buffer)
    if orders is None:
        return
    _LOGGER.warning("the process that streamed is gone: %d vehicles go on from their missions", len(orders.items))
    try:
        failures = asyncio.run(take_over(orders))
    except ConnectionFailed as error:
        _LOGGER.warning("left to whoever has the links now: %s", error)
        return
    for system_id, failure in failures.items():
        _LOGGER.warning("system %d: %s", system_id, failure or "flies its mission")


if __name__ == "__main__":
    main()
