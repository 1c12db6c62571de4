"""Command one vehicle in flight: modes, items, swap, hold, land. All waits are wall seconds.

Every command is confirmed by what the vehicle reports afterwards, not by its acknowledgement alone. A vehicle whose
mode the service does not command (a pilot took over, a failsafe flies) is left alone.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

from skyfolio.mavlink_bridge.autopilots import FlightMode
from skyfolio.mavlink_bridge.confirming import (
    REQUEST,
    ask_until,
    confirm_s,
    error_of,
    heartbeat_until,
    is_ours,
    not_ours,
    require_ours,
    seen_of,
)
from skyfolio.mavlink_bridge.items import Mission
from skyfolio.mavlink_bridge.mission_messages import Message
from skyfolio.mavlink_bridge.results import CommandResult, SwapResult, UploadResult
from skyfolio.mavlink_bridge.transfer import upload_verified
from skyfolio.mavlink_bridge.vehicle import NotDone, Vehicle

REPORT_S = 1.3
"""Wall seconds until the next MISSION_CURRENT of a vehicle that sends it at 1 Hz and not on request (PX4)."""
STREAMS_HZ = {33: 5.0, 42: 1.0, 245: 1.0, 1: 1.0, 24: 1.0}
"""GLOBAL_POSITION_INT, MISSION_CURRENT, EXTENDED_SYS_STATE, SYS_STATUS, GPS_RAW_INT.

ArduPilot streams none unless asked.
"""

SWAP_ATTEMPTS = 2
SWAP_SILENCE_S = 1.5
"""Fewer and shorter than on the ground: a vehicle in flight should not wait long for proof."""
FLY_TRIES = 2
"""Without a second try a mission that is proven to be on board would not be flown because one order was lost."""
PROOF_S = 2.0
"""A vehicle that flies on during its swap (PX4) is commanded to hold if the new mission is not proven by then."""

SET_MODE, _SET_CURRENT, _INTERVAL = 176, 224, 511
CUSTOM_MODE = 1.0
"""param1 of SET_MODE (MAV_CMD_DO_SET_MODE): param2 and param3 are the autopilot's own numbers."""
_HEARTBEAT, _HOME_POSITION = 0, 242


async def command(vehicle: Vehicle, done: Awaitable[None]) -> CommandResult:
    """Await one command and return its end as a result."""
    loop = asyncio.get_running_loop()
    started = loop.time()
    error = await error_of(done)
    return CommandResult(system_id=vehicle.system_id, seconds=loop.time() - started, error=error)


async def ask_for_streams(vehicle: Vehicle) -> None:
    """Request the messages that telemetry is made of (SET_MESSAGE_INTERVAL); an unknown one is left out."""
    for message_id, rate_hz in STREAMS_HZ.items():
        await error_of(vehicle.command(_INTERVAL, float(message_id), 1e6 / rate_hz))
    await error_of(vehicle.command(REQUEST, _HOME_POSITION))


async def set_mode(vehicle: Vehicle, mode: FlightMode) -> None:
    """Change the mode and see it in HEARTBEAT. Raises NotDone."""
    main, sub = vehicle.profile.numbers_of(mode)
    with vehicle.commanding(mode):
        await vehicle.command(SET_MODE, CUSTOM_MODE, main, sub)
        await _in_mode(vehicle, mode)


async def set_current(vehicle: Vehicle, item: int, *, may: Callable[[], bool] = lambda: True) -> None:
    """Make `item` the next to be flown, and see it or the next flown item in MISSION_CURRENT. Raises NotDone.

    may: returns whether it may be sent, or sent again, at this moment.
    """
    if not may():
        raise NotDone(f"item {item} is not made current: it is one of another mission")
    state, before, reports = vehicle.state, vehicle.state.mission_current, vehicle.state.mission_reports
    reported = vehicle.profile.current_after(vehicle.on_board or (), item)

    def is_current() -> bool:
        """Return whether it has been reported since, or even passed; a vehicle that was further has to go back."""
        now = state.mission_current
        if state.mission_reports == reports or now is None:
            return False
        return now in reported or (before is not None and before < reported.start <= now)

    if _SET_CURRENT not in vehicle.unsupported:
        try:
            await vehicle.command(_SET_CURRENT, float(item))
        except NotDone:
            if _SET_CURRENT not in vehicle.unsupported:
                raise
    if _SET_CURRENT in vehicle.unsupported:
        seen = await _insist_on_item(vehicle, item, is_current, may)
    else:
        seen = await ask_until(vehicle, is_current)
    if not seen:
        raise NotDone(f"item {item} did not become current: {seen_of(vehicle)}")


async def _insist_on_item(vehicle: Vehicle, item: int, is_current: Callable[[], bool], may: Callable[[], bool]) -> bool:
    """Send MISSION_SET_CURRENT, which has no acknowledgement, again with each report that does not show the item.

    Return whether the item became current.
    """
    order = Message("MISSION_SET_CURRENT", {"target_system": vehicle.system_id, "target_component": 1, "seq": item})
    loop, wait_s = asyncio.get_running_loop(), REPORT_S + 2 * vehicle.round_trip.seconds
    deadline_s = loop.time() + confirm_s(vehicle)
    while not is_current():
        left_s = deadline_s - loop.time()
        if left_s <= 0 or not may():
            return False
        vehicle.send(order)
        await ask_until(vehicle, is_current, min(wait_s, left_s))
    return True


async def hold(vehicle: Vehicle) -> None:
    """Stop here and hover, seen in HEARTBEAT. Raises NotDone."""
    await set_mode(vehicle, vehicle.profile.hold_mode)


async def land(vehicle: Vehicle) -> None:
    """Begin to descend here, seen in HEARTBEAT; touching down takes longer than this waits. Raises NotDone."""
    await set_mode(vehicle, FlightMode.LAND)


async def return_home(vehicle: Vehicle) -> None:
    """Begin to return to where it took off, seen in HEARTBEAT. Raises NotDone."""
    await set_mode(vehicle, FlightMode.RETURN)


async def swap(vehicle: Vehicle, mission: Mission, given_up: Callable[[], bool]) -> SwapResult:
    """Replace the mission of a vehicle in flight, prove that it has the new one, and see that it flies it.

    PX4 takes a whole mission at once and flies on meanwhile. ArduPilot writes into the mission it flies, so it hovers
    (GUIDED) while it is uploaded, and flies on (AUTO) once it is proven: about a quarter of a second on a good link. If
    a step fails, the vehicle flies the mission from before on, if that is proven to be on board whole; else it holds.
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
    """Command it to fly the new mission, which is on board; return why it does not, after the second try."""
    error: str | None = None
    for _ in range(FLY_TRIES):
        error = await error_of(_fly_new(vehicle, mission, mission_id))
        if error is None or not is_ours(vehicle):
            break
    return error


async def _go_on(vehicle: Vehicle, at_item: int | None) -> None:
    """Fly the mission from before the swap on, from its item at that time: restoring it may have restarted it."""
    now = vehicle.state.mission_current
    flies = vehicle.state.mode is FlightMode.MISSION
    if at_item is not None and not (flies and now is not None and now >= at_item):
        await set_current(vehicle, at_item)
    if vehicle.state.mode is not FlightMode.MISSION:
        await set_mode(vehicle, FlightMode.MISSION)


async def _upload_or_hold(vehicle: Vehicle, mission: Mission, given_up: Callable[[], bool]) -> UploadResult:
    """Upload the mission, and hold a vehicle that still flies one after PROOF_S and two round trips.

    It holds until it is known which mission it has.
    """
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


def _refused(vehicle: Vehicle, reason: str) -> SwapResult:
    upload = UploadResult(system_id=vehicle.system_id, seconds=0.0, error=reason)
    return SwapResult(system_id=vehicle.system_id, seconds=0.0, error=reason, upload=upload)


async def _fly_new(vehicle: Vehicle, mission: Mission, mission_id: int) -> None:
    """See the new mission being flown; if it is not yet, set its first item current and start it.

    PX4 flies a new mission at once. If it reports that by the mission's checksum nothing is sent: going back to the
    first item would undo what it has flown since.
    """
    reports_checksum = mission_id != 0 and vehicle.profile.replaces_whole and vehicle.state.mode is FlightMode.MISSION
    wait_s = REPORT_S + 2 * vehicle.round_trip.seconds
    if reports_checksum and await ask_until(vehicle, lambda: _flies_new(vehicle, mission, mission_id, -1), wait_s):
        return
    require_ours(vehicle)
    reports = vehicle.state.mission_reports
    await set_current(vehicle, mission.start_item)
    require_ours(vehicle)
    if vehicle.state.mode is not FlightMode.MISSION:
        await set_mode(vehicle, FlightMode.MISSION)
    if not await ask_until(vehicle, lambda: _flies_new(vehicle, mission, mission_id, reports)):
        raise NotDone(f"not flying the new mission after {confirm_s(vehicle):.1f} s: {seen_of(vehicle)}")


def _flies_new(vehicle: Vehicle, mission: Mission, mission_id: int, reports: int) -> bool:
    """Return whether a MISSION_CURRENT later than number `reports` shows the new mission, in mission mode."""
    state = vehicle.state
    return (
        state.mode is FlightMode.MISSION
        and state.mission_reports > reports
        and state.mission_total in (None, len(mission.items))
        and (not mission_id or state.mission_id == mission_id)
    )


async def _in_mode(vehicle: Vehicle, mode: FlightMode) -> None:
    if not await heartbeat_until(vehicle, lambda: vehicle.state.mode is mode):
        raise NotDone(f"acknowledged but not in mode '{mode}' after {confirm_s(vehicle):.1f} s: {seen_of(vehicle)}")
