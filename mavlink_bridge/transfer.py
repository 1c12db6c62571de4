"""Give a vehicle a mission and prove that it has it: upload, read back, compare, try again.

An accepting MISSION_ACK is not proof; a read-back that compares equal is. MAVSDK gives up on a silent vehicle after
about 2.5 s of wall time, however fast the fleet's clock runs.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence

from mavsdk.plugins.mission_raw import MissionItem as RawItem
from mavsdk.plugins.mission_raw import MissionRawError, MissionRawResult

from mavlink_bridge.compare import mission_differences
from mavlink_bridge.items import Mission, MissionItem
from mavlink_bridge.results import UploadResult
from mavlink_bridge.vehicle import Vehicle

ATTEMPTS = 3
_PAUSE_S = 0.1
"""Wall seconds before the second attempt; doubles with each further one."""
_FINAL = frozenset(
    {
        MissionRawResult.TOO_MANY_MISSION_ITEMS,
        MissionRawResult.INVALID_ARGUMENT,
        MissionRawResult.UNSUPPORTED,
        MissionRawResult.NO_SYSTEM,
        MissionRawResult.CURRENT_INVALID,
        MissionRawResult.INT_MESSAGES_NOT_SUPPORTED,
    }
)
"""Answers that the same mission will get again."""


async def upload_verified(
    vehicle: Vehicle, mission: Mission, *, attempts: int = ATTEMPTS, given_up: Callable[[], bool] = lambda: False
) -> UploadResult:
    """Upload until the read-back is equal, at most `attempts` times; `given_up` ends it early (link declared lost)."""
    started = asyncio.get_running_loop().time()
    error: str | None = "not tried"
    attempt = 0
    while attempt < attempts:
        if attempt:
            await asyncio.sleep(_PAUSE_S * 2 ** (attempt - 1))
        attempt += 1
        try:
            error = await _attempt(vehicle, mission)
        except MissionRawError as failed:
            error = f"{failed.origin.removesuffix('()')}: {failed.result.name}"
            if failed.result in _FINAL or given_up():
                break
        if error is None:
            break
    return UploadResult(
        system_id=vehicle.system_id,
        seconds=asyncio.get_running_loop().time() - started,
        error=error,
        verified=error is None,
        attempts=attempt,
        mission_id=(vehicle.state.accepted_id or 0) if error is None else 0,
    )


async def _attempt(vehicle: Vehicle, mission: Mission) -> str | None:
    """One upload and its proof; returns what is wrong, or None."""
    vehicle.state.accepted_id = None
    await vehicle.call(vehicle.mission_raw.upload_mission, [_to_raw(item) for item in mission.items])
    read_back: Sequence[RawItem] = await vehicle.call(vehicle.mission_raw.download_mission)
    differences = mission_differences(mission.items, [_from_raw(item) for item in read_back])
    return f"read-back differs: {'; '.join(differences[:3])}" if differences else None


def _to_raw(item: MissionItem) -> RawItem:
    return RawItem(
        item.seq,
        item.frame,
        item.command,
        item.current,
        item.autocontinue,
        item.param1,
        item.param2,
        item.param3,
        item.param4,
        item.x,
        item.y,
        item.z,
        0,
    )


def _from_raw(raw: RawItem) -> MissionItem:
    return MissionItem(
        seq=raw.seq,
        frame=raw.frame,
        command=raw.command,
        current=raw.current,
        autocontinue=raw.autocontinue,
        param1=raw.param1,
        param2=raw.param2,
        param3=raw.param3,
        param4=raw.param4,
        x=raw.x,
        y=raw.y,
        z=raw.z,
    )
