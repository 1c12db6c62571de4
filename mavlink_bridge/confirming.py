"""Wait for what a vehicle reports after a command, and say what it reported instead. All waits are wall seconds."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

from skyfolio.mavlink_bridge.vehicle import NotDone, Vehicle

CONFIRM_S = 3.0
"""Wall seconds to report what it has acknowledged; HEARTBEAT and MISSION_CURRENT are sent at 1 Hz."""
HEARTBEAT_S = 1.2
"""Wall seconds in which a HEARTBEAT is sent without being requested."""
ASK_AGAIN_S = 0.1
"""A message is requested this often instead of waiting for the next one, where requests are answered."""

REQUEST = 512
"""MAV_CMD_REQUEST_MESSAGE."""
_HEARTBEAT, _MISSION_CURRENT = 0, 42


def confirm_s(vehicle: Vehicle) -> float:
    """Return the wall seconds in which it has to report what it has acknowledged: more on a slow link."""
    return CONFIRM_S + 2 * vehicle.round_trip.seconds


async def ask_until(vehicle: Vehicle, condition: Callable[[], bool], timeout_s: float | None = None) -> bool:
    """Request MISSION_CURRENT every tenth of a second until the condition is true, and return whether it became true.

    A vehicle that refuses the request sends it at 1 Hz, and is waited for. `timeout_s`: default `confirm_s`.
    """
    return await _asking(vehicle, _MISSION_CURRENT, condition, confirm_s(vehicle) if timeout_s is None else timeout_s)


async def heartbeat_until(vehicle: Vehicle, condition: Callable[[], bool]) -> bool:
    """Request HEARTBEAT until the condition is true, and return whether it became true within `confirm_s`."""
    return await _asking(vehicle, _HEARTBEAT, condition, confirm_s(vehicle))


async def _asking(vehicle: Vehicle, message_id: int, condition: Callable[[], bool], timeout_s: float) -> bool:
    loop = asyncio.get_running_loop()
    deadline_s = loop.time() + timeout_s
    request: asyncio.Task[None] | None = None
    try:
        while not condition():
            left_s = deadline_s - loop.time()
            if left_s <= 0:
                return False
            if request is None or request.done():
                if request is not None:
                    request.result()
                request = asyncio.create_task(vehicle.request(message_id))
            await vehicle.wait_until(condition, min(ASK_AGAIN_S, left_s))
    finally:
        if request is not None:
            request.cancel()
            await asyncio.gather(request, return_exceptions=True)
    return True


async def fresh_heartbeat(vehicle: Vehicle) -> bool:
    """Request a HEARTBEAT, wait for one, and return whether one was received: only then its mode is up to date.

    An autopilot that does not send one on request sends one a second anyway.
    """
    heard = vehicle.state.heartbeats
    await error_of(vehicle.command(REQUEST, float(_HEARTBEAT)))
    return await vehicle.wait_until(lambda: vehicle.state.heartbeats > heard, HEARTBEAT_S)


async def error_of(command: Awaitable[None]) -> str | None:
    """Await one command, and return why it was not done; None if it was."""
    try:
        await command
    except NotDone as failure:
        return str(failure)
    return None


def is_ours(vehicle: Vehicle) -> bool:
    """Return whether its mode lets the service command it; in any other a human or a failsafe flies it."""
    return vehicle.state.is_ours


def require_ours(vehicle: Vehicle) -> None:
    """Check that the service may command it. Raises NotDone with the mode in which somebody else flies it."""
    if not is_ours(vehicle):
        raise NotDone(not_ours(vehicle))


def not_ours(vehicle: Vehicle) -> str:
    """Return why it is not commanded, in words."""
    return f"not ours to command: it is in mode '{vehicle.state.mode}'"


def seen_of(vehicle: Vehicle) -> str:
    """Return the mode and item that it reports, in words."""
    state = vehicle.state
    return f"mode '{state.mode}', item {state.mission_current} of {state.mission_total}"
