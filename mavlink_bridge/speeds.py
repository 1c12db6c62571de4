"""Speed orders in flight, and the way back from them. All waits are wall seconds.

MAV_CMD_DO_CHANGE_SPEED (178) outlives the mode it was meant for: PX4 (`FlightTaskAuto::overrideCruiseSpeed`) and
ArduCopter (`ModeRTL::set_speed_xy`) obey it in a return too, so one that arrives just after a failsafe or a pilot has
taken over makes the vehicle crawl home until its battery is empty. HEARTBEAT, the only message that reports the mode,
is sent at 1 Hz. Therefore an order is only sent on a HEARTBEAT that was requested and received just now, the mode is
checked again right after it, and a vehicle that is seen in a mode that is not ours is given its own cruise speed back
at once. That is the only command it is sent then: it undoes our own order and changes nothing else.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass

from skyfolio.mavlink_bridge.autopilots import FlightMode
from skyfolio.mavlink_bridge.confirming import error_of, fresh_heartbeat, seen_of
from skyfolio.mavlink_bridge.vehicle import NotDone, Vehicle

TRIES = 5
"""Each lasts as long as a command is repeated (2 s); a later HEARTBEAT starts anew."""
_CHANGE_SPEED = 178
_GROUND_SPEED, _THROTTLE_UNCHANGED = 1.0, -1.0


@dataclass(frozen=True, kw_only=True)
class SpeedRestored:
    """A vehicle that left our modes at our speed was sent its own cruise speed (m/s); `error`: why that failed."""

    system_id: int
    mode: FlightMode
    speed_mps: float
    error: str | None = None


async def require_in_mission(vehicle: Vehicle) -> None:
    """Raise NotDone unless a HEARTBEAT from now on shows that it flies its mission."""
    if not await fresh_heartbeat(vehicle):
        raise NotDone("no heartbeat shows which mode it is in")
    if vehicle.state.mode is not FlightMode.MISSION:
        raise NotDone(f"not in its mission: {seen_of(vehicle)}")


async def order_speed(vehicle: Vehicle, speed_mps: float) -> None:
    """Order it to fly its mission at this ground speed from now on. Raises NotDone, for any other mode too."""
    await require_in_mission(vehicle)
    await _change(vehicle, speed_mps)
    await fresh_heartbeat(vehicle)  # had it left its mission meanwhile, `SpeedWatch` sees it now


async def restore_speed(vehicle: Vehicle, cruise_mps: float) -> None:
    """Restore its own cruise speed (m/s), whatever flies it. Raises NotDone.

    It is sent as a positive number, not -2 ("default"): PX4's flight tasks have no other way back, ArduCopter refuses
    it.
    """
    await _change(vehicle, cruise_mps)
    vehicle.flies_our_speed = False


async def _change(vehicle: Vehicle, speed_mps: float) -> None:
    try:
        await vehicle.command(_CHANGE_SPEED, _GROUND_SPEED, speed_mps, _THROTTLE_UNCHANGED)
    finally:  # also when it was not answered, or nobody waits for it any more: it may have arrived
        vehicle.flies_our_speed = True


class SpeedWatch:
    """Restores the vehicles' own speed. Show it every HEARTBEAT; `cruise_mps(system_id)` is the speed.

    `tell` is called with what was done.
    """

    def __init__(self, cruise_mps: Callable[[int], float]) -> None:
        self.tell: Callable[[SpeedRestored], None] = lambda _restored: None
        self._cruise_mps = cruise_mps
        self._restoring: dict[int, asyncio.Task[None]] = {}

    def look(self, vehicle: Vehicle) -> None:
        """Look at a vehicle whose HEARTBEAT was just taken in."""
        if not vehicle.state.armed:
            vehicle.flies_our_speed = False  # on the ground; the next flight begins with its own speed
        if not _flies_ours_elsewhere(vehicle) or vehicle.system_id in self._restoring:
            return
        task = asyncio.create_task(self._restore(vehicle), name=f"restore-speed-{vehicle.system_id}")
        self._restoring[vehicle.system_id] = task
        task.add_done_callback(lambda _done: self._restoring.pop(vehicle.system_id, None))

    async def close(self) -> None:
        """Stop restoring."""
        tasks = list(self._restoring.values())
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    async def _restore(self, vehicle: Vehicle) -> None:
        speed_mps, mode, error = self._cruise_mps(vehicle.system_id), vehicle.state.mode, None
        for _ in range(TRIES):
            error = await error_of(restore_speed(vehicle, speed_mps))
            if error is None or not _flies_ours_elsewhere(vehicle):
                break
        self.tell(SpeedRestored(system_id=vehicle.system_id, mode=mode, speed_mps=speed_mps, error=error))


def _flies_ours_elsewhere(vehicle: Vehicle) -> bool:
    """Return whether it is in the air at a speed that we commanded, in a mode that we did not."""
    state = vehicle.state
    return vehicle.flies_our_speed and state.armed and state.profile is not None and not state.is_ours
