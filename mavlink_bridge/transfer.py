"""Give a vehicle a mission, a geofence or rally points, and prove that it has them."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Sequence

from skyfolio.mavlink_bridge.compare import mission_differences
from skyfolio.mavlink_bridge.items import Mission, MissionItem
from skyfolio.mavlink_bridge.mission_messages import SILENCE_S, MissionType
from skyfolio.mavlink_bridge.mission_protocol import Download
from skyfolio.mavlink_bridge.parameters import ParameterRead
from skyfolio.mavlink_bridge.results import ReadResult, Recognised, UploadResult
from skyfolio.mavlink_bridge.vehicle import NotDone, Vehicle
from skyfolio.mavlink_bridge.verified import ATTEMPTS, OnBoard, VerifiedUpload


def never() -> bool:
    """Return false: the upload is never given up early."""
    return False


async def upload_verified(
    vehicle: Vehicle,
    mission: Mission,
    *,
    attempts: int = ATTEMPTS,
    silence_s: float = SILENCE_S,
    given_up: Callable[[], bool] = never,
) -> UploadResult:
    """Upload until the read-back is equal, at most `attempts` times; `given_up` (link declared lost) ends it early.

    If it fails, what was on board before is restored, as far as that is known and the vehicle still answers.
    """
    if vehicle.state.autopilot is not mission.autopilot:
        error = f"the mission is for {mission.autopilot}, the vehicle is {vehicle.autopilot}"
        return UploadResult(system_id=vehicle.system_id, seconds=0.0, error=error)
    result = await upload_items(
        vehicle, mission.items, MissionType.MISSION, attempts=attempts, silence_s=silence_s, given_up=given_up
    )
    if result.verified:
        vehicle.start_item = mission.start_item
    return result


async def upload_items(
    vehicle: Vehicle,
    items: Sequence[MissionItem],
    mission_type: MissionType,
    *,
    attempts: int = ATTEMPTS,
    silence_s: float = SILENCE_S,
    given_up: Callable[[], bool] = never,
) -> UploadResult:
    """Upload items of any mission type, proven in the same way. An empty list clears."""
    loop = asyncio.get_running_loop()
    started = loop.time()
    flown = mission_type is MissionType.MISSION
    old = vehicle.on_board if flown else None
    transfer = VerifiedUpload(
        items,
        vehicle.system_id,
        autopilot=vehicle.autopilot,
        old=old,
        mission_type=mission_type,
        attempts=attempts,
        silence_s=silence_s,
        round_trip=vehicle.round_trip,
    )
    if flown:
        vehicle.state.accepted_id, vehicle.on_board = None, None
    await vehicle.converse(transfer, given_up)
    if flown:
        proven = {OnBoard.NEW: tuple(items), OnBoard.OLD: old}
        vehicle.on_board = None if transfer.on_board is None else proven.get(transfer.on_board)
    return UploadResult(
        system_id=vehicle.system_id,
        seconds=loop.time() - started,
        error=transfer.error,
        verified=transfer.error is None,
        on_board=transfer.on_board or OnBoard.UNKNOWN,
        attempts=transfer.attempts,
        mission_id=transfer.opaque_id if transfer.error is None else 0,
    )


async def recognise(vehicle: Vehicle, missions: Sequence[Mission], given_up: Callable[[], bool] = never) -> Recognised:
    """Read back what is on board and find it among `missions`; then it is known, as after an upload."""
    loop = asyncio.get_running_loop()
    started = loop.time()
    reading = await read_items(vehicle, MissionType.MISSION, given_up)
    mission, error, read, autopilot = None, reading.error, reading.items, vehicle.autopilot
    if error is None:
        equal = (known for known in missions if not mission_differences(known.items, read, autopilot=autopilot))
        mission = next(equal, None)
        error = None if mission is not None else f"{len(read)} items on board, and they are none of the known missions"
    if mission is not None:
        vehicle.on_board, vehicle.start_item = mission.items, mission.start_item
    return Recognised(system_id=vehicle.system_id, seconds=loop.time() - started, error=error, mission=mission)


async def read_items(vehicle: Vehicle, mission_type: MissionType, given_up: Callable[[], bool] = never) -> ReadResult:
    """Read what is on board of one mission type."""
    loop = asyncio.get_running_loop()
    started = loop.time()
    window, round_trip = vehicle.profile.read_window, vehicle.round_trip
    reading = Download(vehicle.system_id, mission_type=mission_type, window=window, round_trip=round_trip)
    await vehicle.converse(reading, given_up)
    error = "not read" if reading.ended is None else reading.ended.error
    items = tuple(reading.items) if error is None else ()
    return ReadResult(system_id=vehicle.system_id, seconds=loop.time() - started, error=error, items=items)


async def read_parameters(vehicle: Vehicle, names: Iterable[str]) -> dict[str, float]:
    """Return the values of those parameters the vehicle knows. Raises NotDone for an unknown autopilot."""
    reading = ParameterRead(names, vehicle.system_id, vehicle.autopilot, vehicle.round_trip)
    await vehicle.converse(reading)
    return reading.values


__all__ = ["ATTEMPTS", "NotDone", "read_items", "read_parameters", "recognise", "upload_items", "upload_verified"]
