"""Fly one vehicle: launch, go to, start, swap in flight, hold, land. All waits are wall seconds.

Every command is confirmed by what the vehicle reports afterwards, not by its acknowledgement alone. A vehicle whose
mode is not one of ours (a pilot took over, a failsafe flies) is left alone.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from math import hypot, nan

from mavsdk.plugins.action import ActionError
from mavsdk.plugins.mission_raw import MissionRawError

from mavlink_bridge.autopilots import FlightMode
from mavlink_bridge.geodesy import geodetic_to_east_north
from mavlink_bridge.items import Mission
from mavlink_bridge.results import CommandResult, SwapResult, UploadResult
from mavlink_bridge.transfer import upload_verified
from mavlink_bridge.vehicle import Vehicle
from planner.scenario import Origin

ALTITUDE_TOLERANCE_M = 1.0
ARRIVAL_TOLERANCE_M = 1.0
ARRIVAL_SPEED_MPS = 0.5
CONFIRM_S = 3.0
"""Wall seconds to report that it does what it acknowledged; HEARTBEAT and MISSION_CURRENT come at 1 Hz."""

SWAP_ATTEMPTS = 2
"""Fewer than on the ground: a vehicle in flight should not wait long for proof before it is told to hold."""

_OURS = frozenset({FlightMode.MISSION, FlightMode.HOLD, FlightMode.TAKEOFF, FlightMode.READY})
"""Modes a vehicle may be in to be given a new mission in flight."""


class NotDone(Exception):  # noqa: N818 (ends one command of one vehicle; becomes its result's error text)
    """The vehicle did not do it; the text says what was seen instead."""


async def command(vehicle: Vehicle, done: Awaitable[None]) -> CommandResult:
    """Await one command and make its end a result."""
    loop = asyncio.get_running_loop()
    started = loop.time()
    error = await _error_of(done)
    return CommandResult(system_id=vehicle.system_id, seconds=loop.time() - started, error=error)


async def launch(vehicle: Vehicle, altitude_m: float, timeout_s: float) -> None:
    """Arm, take off, and be within 1 m of `altitude_m` above home (or higher) in `timeout_s` wall seconds."""
    await vehicle.call(vehicle.action.set_takeoff_altitude, altitude_m)
    await vehicle.call(vehicle.action.arm)
    await vehicle.call(vehicle.action.takeoff)
    if not await vehicle.wait_until(lambda: _altitude(vehicle) >= altitude_m - ALTITUDE_TOLERANCE_M, timeout_s):
        raise NotDone(f"at {_altitude(vehicle):.1f} of {altitude_m:g} m after {timeout_s:g} s")


async def go_to(vehicle: Vehicle, lat_deg: float, lon_deg: float, relative_alt_m: float, timeout_s: float) -> None:
    """Fly straight to a point (degrees, metres above home) and come to rest there."""
    now = vehicle.state.snapshot()
    if now is None:
        raise NotDone("its position is not known yet")
    amsl_m = now.altitude_amsl_m - now.relative_alt_m + relative_alt_m
    await vehicle.call(vehicle.action.goto_location, lat_deg, lon_deg, amsl_m, nan)
    if not await vehicle.wait_until(lambda: _is_at(vehicle, lat_deg, lon_deg, relative_alt_m), timeout_s):
        raise NotDone(f"{_distance(vehicle, lat_deg, lon_deg):.1f} m away after {timeout_s:g} s")


async def set_current(vehicle: Vehicle, item: int) -> None:
    """Make `item` the next to be flown."""
    await vehicle.call(vehicle.mission_raw.set_current_mission_item, item)


async def start(vehicle: Vehicle, item: int) -> None:
    """Enter mission mode and see it fly `item` or a later one (HEARTBEAT and MISSION_CURRENT)."""
    reports = vehicle.state.mission_reports
    await vehicle.call(vehicle.mission_raw.start_mission)
    if not await vehicle.wait_until(lambda: _flies_from(vehicle, item, reports), CONFIRM_S):
        raise NotDone(f"not flying item {item} after {CONFIRM_S:g} s: {_seen(vehicle)}")


async def hold(vehicle: Vehicle) -> None:
    """Stop here and hover, seen in HEARTBEAT."""
    await vehicle.call(vehicle.action.hold)
    await _in_mode(vehicle, FlightMode.HOLD)


async def land(vehicle: Vehicle) -> None:
    """Begin to descend here, seen in HEARTBEAT; touching down takes longer than this waits."""
    await vehicle.call(vehicle.action.land)
    await _in_mode(vehicle, FlightMode.LAND)


async def swap(vehicle: Vehicle, mission: Mission, given_up: Callable[[], bool]) -> SwapResult:
    """Replace the mission of a vehicle in flight: verified and flying the new one, or holding, and saying so."""
    loop = asyncio.get_running_loop()
    started = loop.time()
    mode = vehicle.state.mode
    if mode not in _OURS:
        refused = f"not ours to command: it is in mode '{mode}'"
        upload = UploadResult(system_id=vehicle.system_id, seconds=0.0, error=refused)
        return SwapResult(system_id=vehicle.system_id, seconds=0.0, error=refused, upload=upload)
    upload = await upload_verified(vehicle, mission, attempts=SWAP_ATTEMPTS, given_up=given_up)
    error = upload.error or await _error_of(_fly_new(vehicle, mission, upload.mission_id))
    held = error is not None and await _error_of(hold(vehicle)) is None
    return SwapResult(system_id=vehicle.system_id, seconds=loop.time() - started, error=error, upload=upload, held=held)


async def _fly_new(vehicle: Vehicle, mission: Mission, mission_id: int) -> None:
    """See the new mission being flown; where it is not yet, set item 0 current and start.

    PX4 takes a new mission at once. If it says so by the mission's checksum nothing is sent: going back to item 0
    would undo what it has flown since.
    """
    if mission_id and _flies_new(vehicle, mission, mission_id, reports=-1):
        return
    reports = vehicle.state.mission_reports
    await set_current(vehicle, 0)
    if vehicle.state.mode is not FlightMode.MISSION:
        await vehicle.call(vehicle.mission_raw.start_mission)
    if not await vehicle.wait_until(lambda: _flies_new(vehicle, mission, mission_id, reports), CONFIRM_S):
        raise NotDone(f"not flying the new mission after {CONFIRM_S:g} s: {_seen(vehicle)}")


def _flies_new(vehicle: Vehicle, mission: Mission, mission_id: int, reports: int) -> bool:
    """Whether a MISSION_CURRENT later than number `reports` tells of the new mission, in mission mode."""
    state = vehicle.state
    return (
        state.mode is FlightMode.MISSION
        and state.mission_reports > reports
        and state.mission_total in (None, len(mission.items))
        and (not mission_id or state.mission_id == mission_id)
    )


def _flies_from(vehicle: Vehicle, item: int, reports: int) -> bool:
    state = vehicle.state
    current = state.mission_current
    return (
        state.mode is FlightMode.MISSION and state.mission_reports > reports and current is not None and current >= item
    )


async def _in_mode(vehicle: Vehicle, mode: FlightMode) -> None:
    if not await vehicle.wait_until(lambda: vehicle.state.mode is mode, CONFIRM_S):
        raise NotDone(f"acknowledged but not in mode '{mode}' after {CONFIRM_S:g} s: {_seen(vehicle)}")


async def _error_of(done: Awaitable[None]) -> str | None:
    try:
        await done
    except NotDone as failed:
        return str(failed)
    except (ActionError, MissionRawError) as failed:
        return f"{failed.origin.removesuffix('()')}: {failed.result.name}"
    return None


def _altitude(vehicle: Vehicle) -> float:
    now = vehicle.state.snapshot()
    return -1.0 if now is None else now.relative_alt_m


def _distance(vehicle: Vehicle, lat_deg: float, lon_deg: float) -> float:
    """Metres over ground between the vehicle and a point."""
    now = vehicle.state.snapshot()
    if now is None:
        return nan
    return hypot(*geodetic_to_east_north(Origin(lat_deg=lat_deg, lon_deg=lon_deg), now.lat_deg, now.lon_deg))


def _is_at(vehicle: Vehicle, lat_deg: float, lon_deg: float, relative_alt_m: float) -> bool:
    now = vehicle.state.snapshot()
    return (
        now is not None
        and _distance(vehicle, lat_deg, lon_deg) <= ARRIVAL_TOLERANCE_M
        and abs(now.relative_alt_m - relative_alt_m) <= ALTITUDE_TOLERANCE_M
        and hypot(now.velocity_north_mps, now.velocity_east_mps) <= ARRIVAL_SPEED_MPS
    )


def _seen(vehicle: Vehicle) -> str:
    state = vehicle.state
    return f"mode '{state.mode}', item {state.mission_current} of {state.mission_total}"
