"""Command one vehicle in flight: modes, items, swap, hold, land. All waits are wall seconds.

Every command is confirmed by what the vehicle reports afterwards, not by its acknowledgement alone. A vehicle whose
mode is not one of ours (a pilot took over, a failsafe flies) is left alone.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

from skyfolio.mavlink_bridge.autopilots import FlightMode
from skyfolio.mavlink_bridge.items import Mission
from skyfolio.mavlink_bridge.mission_messages import Message
from skyfolio.mavlink_bridge.results import CommandResult, SwapResult, UploadResult
from skyfolio.mavlink_bridge.transfer import upload_verified
from skyfolio.mavlink_bridge.vehicle import NotDone, Vehicle

CONFIRM_S = 3.0
"""Wall seconds to report that it does what it acknowledged; HEARTBEAT and MISSION_CURRENT come at 1 Hz."""
REPORT_S = 1.3
"""Wall seconds until the next MISSION_CURRENT of a vehicle that tells it at 1 Hz and not when it is asked (PX4)."""
HEARTBEAT_S = 1.2
"""Wall seconds in which a HEARTBEAT comes by itself."""
ASK_AGAIN_S = 0.1
"""Instead of waiting for the next MISSION_CURRENT it is asked for this often, where that is answered."""
STREAMS_HZ = {33: 5.0, 42: 1.0, 245: 1.0, 1: 1.0, 24: 1.0}
"""GLOBAL_POSITION_INT, MISSION_CURRENT, EXTENDED_SYS_STATE, SYS_STATUS, GPS_RAW_INT: ArduPilot streams none unasked."""

SWAP_ATTEMPTS = 2
SWAP_SILENCE_S = 1.5
"""Fewer and shorter than on the ground: a vehicle in flight should not wait long for proof."""
FLY_TRIES = 2
"""Without a second try a mission that is proven on board would not be flown because one order was not seen."""
PROOF_S = 2.0
"""A vehicle that flies on during its swap (PX4) is told to hold when the new mission is not proven by then."""

SET_MODE, _SET_CURRENT, _INTERVAL, REQUEST = 176, 224, 511, 512
CUSTOM_MODE = 1.0
"""param1 of SET_MODE (MAV_CMD_DO_SET_MODE): param2 and 3 are the autopilot's own numbers."""
_HEARTBEAT, _MISSION_CURRENT, _HOME_POSITION = 0, 42, 242


async def command(vehicle: Vehicle, done: Awaitable[None]) -> CommandResult:
    """Await one command and make its end a result."""
    loop = asyncio.get_running_loop()
    started = loop.time()
    error = await error_of(done)
    return CommandResult(system_id=vehicle.system_id, seconds=loop.time() - started, error=error)


async def ask_for_streams(vehicle: Vehicle) -> None:
    """Have it send what telemetry is made of (SET_MESSAGE_INTERVAL); a stream it does not know is left out."""
    for message_id, rate_hz in STREAMS_HZ.items():
        await error_of(vehicle.command(_INTERVAL, float(message_id), 1e6 / rate_hz))
    await error_of(vehicle.command(REQUEST, _HOME_POSITION))


async def set_mode(vehicle: Vehicle, mode: FlightMode) -> None:
    """Change the mode and see it in HEARTBEAT."""
    main, sub = vehicle.profile.numbers_of(mode)
    with vehicle.commanding(mode):
        await vehicle.command(SET_MODE, CUSTOM_MODE, main, sub)
        await _in_mode(vehicle, mode)


def confirm_s(vehicle: Vehicle) -> float:
    """Wall seconds in which it has to be seen to do what it acknowledged: longer on a slow link."""
    return CONFIRM_S + 2 * vehicle.round_trip.seconds


async def set_current(vehicle: Vehicle, item: int) -> None:
    """Make `item` the next to be flown, seen in MISSION_CURRENT: that item, or the next one that is flown."""
    state, before, reports = vehicle.state, vehicle.state.mission_current, vehicle.state.mission_reports
    told = vehicle.profile.current_after(vehicle.on_board or (), item)

    def is_current() -> bool:
        """Whether it has been told since, or it has even passed it; a vehicle that was further has to go back."""
        now = state.mission_current
        if state.mission_reports == reports or now is None:
            return False
        return now in told or (before is not None and before < told.start <= now)

    if _SET_CURRENT not in vehicle.unsupported:
        try:
            await vehicle.command(_SET_CURRENT, float(item))
        except NotDone:
            if _SET_CURRENT not in vehicle.unsupported:
                raise
    if _SET_CURRENT in vehicle.unsupported:
        seen = await _insist_on_item(vehicle, item, is_current)
    else:
        seen = await ask_until(vehicle, is_current)
    if not seen:
        raise NotDone(f"item {item} did not become current: {seen_of(vehicle)}")


async def _insist_on_item(vehicle: Vehicle, item: int, is_current: Callable[[], bool]) -> bool:
    """MISSION_SET_CURRENT, which has no acknowledgement: sent again with each report that does not show it."""
    order = Message("MISSION_SET_CURRENT", {"target_system": vehicle.system_id, "target_component": 1, "seq": item})
    loop, wait_s = asyncio.get_running_loop(), REPORT_S + 2 * vehicle.round_trip.seconds
    deadline_s = loop.time() + confirm_s(vehicle)
    while not is_current():
        left_s = deadline_s - loop.time()
        if left_s <= 0:
            return False
        vehicle.send(order)
        await ask_until(vehicle, is_current, min(wait_s, left_s))
    return True


async def hold(vehicle: Vehicle) -> None:
    """Stop here and hover, seen in HEARTBEAT."""
    await set_mode(vehicle, vehicle.profile.hold_mode)


async def land(vehicle: Vehicle) -> None:
    """Begin to descend here, seen in HEARTBEAT; touching down takes longer than this waits."""
    await set_mode(vehicle, FlightMode.LAND)


async def return_home(vehicle: Vehicle) -> None:
    """Begin to return to where it took off, seen in HEARTBEAT."""
    await set_mode(vehicle, FlightMode.RETURN)


async def swap(vehicle: Vehicle, mission: Mission, given_up: Callable[[], bool]) -> SwapResult:
    """Replace the mission of a vehicle in flight: verified and flying the new one.

    PX4 takes a whole mission at once and flies on meanwhile. ArduPilot writes into the mission it flies, so it hovers
    (GUIDED) while it is uploaded, and goes on (AUTO) once it is proven: about a quarter of a second on a good link.
    When a step fails, the mission from before goes on, if it is proven to be on board whole; else the vehicle holds.
    """
    loop = asyncio.get_running_loop()
    started = loop.time()
    if not is_ours(vehicle):
        return _refused(vehicle, not_ours(vehicle))
    old, at_item = vehicle.on_board, vehicle.state.mission_current
    upload = UploadResult(system_id=vehicle.system_id, seconds=0.0, error="not tried")
    error: str | None = None
    if vehicle.profile.replaces_whole:
        await vehicle.request(_HEARTBEAT)  # so that the round trip is known, should the link have become slow
    else:
        error = await error_of(hold(vehicle))
    if error is None:
        upload = await _upload_or_hold(vehicle, mission, given_up)
        error = upload.error or await _insist_on_new(vehicle, mission, upload.mission_id)
    went_on = held = False
    if error is not None and is_ours(vehicle):
        went_on = old is not None and vehicle.on_board == old and await error_of(_go_on(vehicle, at_item)) is None
        held = not went_on and is_ours(vehicle) and await error_of(hold(vehicle)) is None
    return SwapResult(
        system_id=vehicle.system_id,
        seconds=loop.time() - started,
        error=error,
        upload=upload,
        held=held,
        went_on=went_on,
    )


async def _insist_on_new(vehicle: Vehicle, mission: Mission, mission_id: int) -> str | None:
    """Have it fly the new mission, which is on board; why it does not, after the second try."""
    error: str | None = None
    for _ in range(FLY_TRIES):
        error = await error_of(_fly_new(vehicle, mission, mission_id))
        if error is None or not is_ours(vehicle):
            break
    return error


async def _go_on(vehicle: Vehicle, at_item: int | None) -> None:
    """Fly the mission from before the swap on, from the item it was at: putting it back may have begun it anew."""
    now = vehicle.state.mission_current
    flies = vehicle.state.mode is FlightMode.MISSION
    if at_item is not None and not (flies and now is not None and now >= at_item):
        await set_current(vehicle, at_item)
    if vehicle.state.mode is not FlightMode.MISSION:
        await set_mode(vehicle, FlightMode.MISSION)


async def _upload_or_hold(vehicle: Vehicle, mission: Mission, given_up: Callable[[], bool]) -> UploadResult:
    """Upload; a vehicle that still flies a mission after PROOF_S and two round trips holds until it is known which."""
    upload = asyncio.create_task(
        upload_verified(vehicle, mission, attempts=SWAP_ATTEMPTS, silence_s=SWAP_SILENCE_S, given_up=given_up)
    )
    try:
        await asyncio.wait({upload}, timeout=PROOF_S + 2 * vehicle.round_trip.seconds)
        if not upload.done() and vehicle.state.mode is FlightMode.MISSION:  # not over a human or a failsafe
            await error_of(hold(vehicle))
        return await upload
    finally:
        upload.cancel()


def is_ours(vehicle: Vehicle) -> bool:
    """Whether it is in a mode of ours; in any other a human or a failsafe flies it, and is not overruled."""
    return vehicle.state.is_ours


def not_ours(vehicle: Vehicle) -> str:
    """Why it is not commanded, in words."""
    return f"not ours to command: it is in mode '{vehicle.state.mode}'"


def _refused(vehicle: Vehicle, reason: str) -> SwapResult:
    upload = UploadResult(system_id=vehicle.system_id, seconds=0.0, error=reason)
    return SwapResult(system_id=vehicle.system_id, seconds=0.0, error=reason, upload=upload)


async def _fly_new(vehicle: Vehicle, mission: Mission, mission_id: int) -> None:
    """See the new mission being flown; where it is not yet, set its first item current and start.

    PX4 takes a new mission at once. If it says so by the mission's checksum nothing is sent: going back to the first
    item would undo what it has flown since.
    """
    told = mission_id != 0 and vehicle.profile.replaces_whole and vehicle.state.mode is FlightMode.MISSION
    wait_s = REPORT_S + 2 * vehicle.round_trip.seconds
    if told and await ask_until(vehicle, lambda: _flies_new(vehicle, mission, mission_id, -1), wait_s):
        return
    if not is_ours(vehicle):
        raise NotDone(not_ours(vehicle))
    reports = vehicle.state.mission_reports
    await set_current(vehicle, mission.start_item)
    if not is_ours(vehicle):
        raise NotDone(not_ours(vehicle))
    if vehicle.state.mode is not FlightMode.MISSION:
        await set_mode(vehicle, FlightMode.MISSION)
    if not await ask_until(vehicle, lambda: _flies_new(vehicle, mission, mission_id, reports)):
        raise NotDone(f"not flying the new mission after {confirm_s(vehicle):.1f} s: {seen_of(vehicle)}")


def _flies_new(vehicle: Vehicle, mission: Mission, mission_id: int, reports: int) -> bool:
    """Whether a MISSION_CURRENT later than number `reports` tells of the new mission, in mission mode."""
    state = vehicle.state
    return (
        state.mode is FlightMode.MISSION
        and state.mission_reports > reports
        and state.mission_total in (None, len(mission.items))
        and (not mission_id or state.mission_id == mission_id)
    )


async def ask_until(vehicle: Vehicle, condition: Callable[[], bool], timeout_s: float | None = None) -> bool:
    """Ask for MISSION_CURRENT every tenth of a second until the condition is true; it comes at 1 Hz by itself.

    A vehicle that refuses to be asked is waited for. `timeout_s`: default `confirm_s`.
    """
    return await _asking(vehicle, _MISSION_CURRENT, condition, confirm_s(vehicle) if timeout_s is None else timeout_s)


async def _in_mode(vehicle: Vehicle, mode: FlightMode) -> None:
    if not await heartbeat_until(vehicle, lambda: vehicle.state.mode is mode):
        raise NotDone(f"acknowledged but not in mode '{mode}' after {confirm_s(vehicle):.1f} s: {seen_of(vehicle)}")


async def heartbeat_until(vehicle: Vehicle, condition: Callable[[], bool]) -> bool:
    """Whether HEARTBEAT shows it within `confirm_s`; it comes once a second, so it is asked for."""
    return await _asking(vehicle, _HEARTBEAT, condition, confirm_s(vehicle))


async def _asking(vehicle: Vehicle, message_id: int, condition: Callable[[], bool], timeout_s: float) -> bool:
    loop = asyncio.get_running_loop()
    deadline_s = loop.time() + timeout_s
    asked: asyncio.Task[None] | None = None
    try:
        while not condition():
            left_s = deadline_s - loop.time()
            if left_s <= 0:
                return False
            if asked is None or asked.done():
                if asked is not None:
                    asked.result()
                asked = asyncio.create_task(vehicle.request(message_id))
            await vehicle.wait_until(condition, min(ASK_AGAIN_S, left_s))
    finally:
        if asked is not None:
            asked.cancel()
            await asyncio.gather(asked, return_exceptions=True)
    return True


async def fresh_heartbeat(vehicle: Vehicle) -> bool:
    """Ask for a HEARTBEAT and wait for one; whether one came. Only then its mode is that of this moment.

    An autopilot that does not send one on demand sends one a second anyway.
    """
    heard = vehicle.state.heartbeats
    await error_of(vehicle.command(REQUEST, float(_HEARTBEAT)))
    return await vehicle.wait_until(lambda: vehicle.state.heartbeats > heard, HEARTBEAT_S)


async def error_of(done: Awaitable[None]) -> str | None:
    """Await one command; why it was not done, or None."""
    try:
        await done
    except NotDone as failed:
        return str(failed)
    return None


def seen_of(vehicle: Vehicle) -> str:
    """Its mode and item, in words."""
    state = vehicle.state
    return f"mode '{state.mode}', item {state.mission_current} of {state.mission_total}"
