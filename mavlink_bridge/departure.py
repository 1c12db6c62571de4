"""Bring one vehicle to where its mission begins: launch, go to, and start. All waits are wall seconds.

As in `flight`, every command is confirmed by what the vehicle reports afterwards.
"""

from __future__ import annotations

import asyncio
from contextlib import nullcontext
from math import hypot, nan

from skyfolio.mavlink_bridge.autopilots import FlightMode
from skyfolio.mavlink_bridge.confirming import (
    ask_until,
    confirm_s,
    error_of,
    heartbeat_until,
    is_ours,
    require_ours,
    seen_of,
)
from skyfolio.mavlink_bridge.e7 import to_e7
from skyfolio.mavlink_bridge.flight import CUSTOM_MODE, SET_MODE, set_mode
from skyfolio.mavlink_bridge.items import Frame
from skyfolio.mavlink_bridge.readiness import ARM, ARMABLE_WITHIN_S, OnRefused, arm_when_ready
from skyfolio.mavlink_bridge.vehicle import NotDone, Vehicle
from skyfolio.planner.geodesy import geodetic_to_east_north
from skyfolio.planner.scenario import Origin

ALTITUDE_TOLERANCE_M = 1.0
ARRIVAL_TOLERANCE_M = 1.0
ARRIVAL_SPEED_MPS = 0.5
FRESHLY_ARMED_S = 4.0
"""Wall seconds after arming within which a vehicle surely takes off before it disarms by itself."""
ON_GROUND_M = 2.0
"""Metres above home: one that is higher is not disarmed."""
RISES_WITHIN_S, RISEN_M = 5.0, 0.5
"""Within so many wall seconds a vehicle that follows the order to take off has risen so far."""
INSIST_EVERY_S, INSIST_TIMES = 0.04, 8
"""At 10 % loss each way eight vehicles start within 0.15 s of each other in all but one launch in a hundred."""

_TAKEOFF, _REPOSITION = 22, 192
_CHANGE_MODE = 1.0


async def arm(
    vehicle: Vehicle, patience_s: float = ARMABLE_WITHIN_S, on_refused: OnRefused = lambda _why: None
) -> None:
    """Arm it where it stands, in the mode it takes off from, within `patience_s` wall seconds. Raises NotDone."""
    mode = vehicle.profile.takeoff.armed_in
    if mode is not None:
        await set_mode(vehicle, mode)
    was_armed = vehicle.state.armed
    await arm_when_ready(vehicle, patience_s, on_refused)
    if not was_armed:
        vehicle.armed_at_s = asyncio.get_running_loop().time()


async def launch(
    vehicle: Vehicle, altitude_m: float, timeout_s: float, on_refused: OnRefused = lambda _why: None
) -> None:
    """Arm, take off, and climb to within 1 m of `altitude_m` above home (or higher) in `timeout_s` wall seconds.

    Raises NotDone if that takes longer, and at once if the vehicle disarms on the way or changes to a mode in which the
    service may not command it.
    """
    await _disarm_if_stale(vehicle)
    await arm(vehicle, min(timeout_s, ARMABLE_WITHIN_S), on_refused)
    now = vehicle.state.snapshot()
    if now is None or now.place_deg is None:
        raise NotDone("its position is not known yet")
    takeoff = vehicle.profile.takeoff
    params = takeoff.params(altitude_m, now.altitude_amsl_m - now.relative_alt_m)
    with nullcontext() if takeoff.mode is None else vehicle.commanding(takeoff.mode):
        try:
            await vehicle.command(_TAKEOFF, *params)
        except NotDone:
            if not await _rises(vehicle, now.relative_alt_m):
                raise
    if not await heartbeat_until(vehicle, lambda: vehicle.state.armed and is_ours(vehicle)):
        raise NotDone(
            f"commanded to take off, but {'armed' if vehicle.state.armed else 'not armed'}: {seen_of(vehicle)}"
        )
    climb = _Climb(vehicle, altitude_m)
    if not await vehicle.wait_until(climb.is_over, timeout_s):
        raise NotDone(f"at {climb.up_m:.1f} of {altitude_m:g} m after {timeout_s:g} s")
    if climb.broken_off is not None:
        raise NotDone(f"{climb.broken_off} at {climb.up_m:.1f} of {altitude_m:g} m")


async def _disarm_if_stale(vehicle: Vehicle) -> None:
    """Disarm it on the ground if it was armed a while ago, so that its time to take off begins anew.

    Both autopilots disarm by themselves 10 s after arming, also just after they have accepted a take-off. One that
    refuses to disarm does not stand on the ground.
    """
    now, armed_s = vehicle.state.snapshot(), asyncio.get_running_loop().time() - vehicle.armed_at_s
    if now is None or not now.armed or armed_s <= FRESHLY_ARMED_S or now.relative_alt_m > ON_GROUND_M:
        return
    if await error_of(vehicle.command(ARM, 0.0)) is None:
        await heartbeat_until(vehicle, lambda: not vehicle.state.armed)


async def _rises(vehicle: Vehicle, ground_m: float) -> bool:
    """Return whether it takes off though its answer says that it does not.

    ArduCopter answers FAILED to a copy of the order once it follows it: then the answer to the first one was lost. So
    may be the HEARTBEAT that says that it is armed, which is asked for.
    """

    def has_risen() -> bool:
        up = vehicle.state.snapshot()
        return up is not None and up.relative_alt_m > ground_m + RISEN_M

    if not await heartbeat_until(vehicle, lambda: vehicle.state.armed and is_ours(vehicle)):
        return False
    await vehicle.wait_until(lambda: has_risen() or not vehicle.state.armed or not is_ours(vehicle), RISES_WITHIN_S)
    return has_risen() and vehicle.state.armed and is_ours(vehicle)


class _Climb:
    """A vehicle that was seen armed and ours, on its way up, and the reason why it will not arrive."""

    def __init__(self, vehicle: Vehicle, altitude_m: float) -> None:
        self.broken_off: str | None = None
        self._vehicle, self._altitude_m = vehicle, altitude_m

    @property
    def up_m(self) -> float:
        """Return the metres above home, -1 before the first position."""
        now = self._vehicle.state.snapshot()
        return -1.0 if now is None else now.relative_alt_m

    def is_over(self) -> bool:
        """Return whether it has arrived, or will not."""
        if not self._vehicle.state.armed:
            self.broken_off = "disarmed"
        elif not is_ours(self._vehicle):
            self.broken_off = f"in mode '{self._vehicle.state.mode}', which was not commanded,"
        return self.broken_off is not None or self.up_m >= self._altitude_m - ALTITUDE_TOLERANCE_M


async def go_to(vehicle: Vehicle, lat_deg: float, lon_deg: float, relative_alt_m: float, timeout_s: float) -> None:
    """Fly straight to a point (degrees, metres above home) and come to rest there. Raises NotDone."""
    if vehicle.state.place_deg is None:
        raise NotDone("its position is not known yet")
    with vehicle.commanding(vehicle.profile.hold_mode):
        await vehicle.command_int(
            _REPOSITION,
            frame=Frame.GLOBAL_RELATIVE_ALT_INT,
            x=to_e7(lat_deg),
            y=to_e7(lon_deg),
            z=relative_alt_m,
            param1=-1.0,
            param2=_CHANGE_MODE,
            param4=None,
        )
    if not await vehicle.wait_until(lambda: _is_at(vehicle, lat_deg, lon_deg, relative_alt_m), timeout_s):
        raise NotDone(f"{_distance(vehicle, lat_deg, lon_deg):.1f} m away after {timeout_s:g} s")


async def start(vehicle: Vehicle, item: int) -> None:
    """Enter mission mode and see it fly `item` or a later one (HEARTBEAT and MISSION_CURRENT). Raises NotDone.

    The order is repeated until HEARTBEAT shows that it is followed: if the acknowledged one alone is lost, the vehicle
    starts half a second late. A vehicle that somebody has taken over since it arrived is left to them.
    """
    require_ours(vehicle)
    reports = vehicle.state.mission_reports
    insisting = asyncio.create_task(_insist(vehicle, FlightMode.MISSION))
    try:
        await set_mode(vehicle, FlightMode.MISSION)
    finally:
        insisting.cancel()
        await asyncio.gather(insisting, return_exceptions=True)  # what it could not send, the order itself could not
    if not await ask_until(vehicle, lambda: _flies_from(vehicle, item, reports)):
        raise NotDone(f"not flying item {item} after {confirm_s(vehicle):.1f} s: {seen_of(vehicle)}")


async def _insist(vehicle: Vehicle, mode: FlightMode) -> None:
    """Send DO_SET_MODE every INSIST_EVERY_S until HEARTBEAT shows the mode; the vehicle may receive it twice."""
    main, sub = vehicle.profile.numbers_of(mode)
    order = vehicle.command_message(SET_MODE, CUSTOM_MODE, main, sub)
    for _ in range(INSIST_TIMES):
        await asyncio.sleep(INSIST_EVERY_S)
        if vehicle.state.mode is mode or not is_ours(vehicle):
            return
        vehicle.send(order)


def _flies_from(vehicle: Vehicle, item: int, reports: int) -> bool:
    state = vehicle.state
    current = state.mission_current
    return (
        state.mode is FlightMode.MISSION and state.mission_reports > reports and current is not None and current >= item
    )


def _distance(vehicle: Vehicle, lat_deg: float, lon_deg: float) -> float:
    """Return the metres over ground between the vehicle and a point, NaN if its position is unknown."""
    place = vehicle.state.place_deg
    if place is None:
        return nan
    return hypot(*geodetic_to_east_north(Origin(lat_deg=lat_deg, lon_deg=lon_deg), *place))


def _is_at(vehicle: Vehicle, lat_deg: float, lon_deg: float, relative_alt_m: float) -> bool:
    now = vehicle.state.snapshot()
    return (
        now is not None
        and _distance(vehicle, lat_deg, lon_deg) <= ARRIVAL_TOLERANCE_M
        and abs(now.relative_alt_m - relative_alt_m) <= ALTITUDE_TOLERANCE_M
        and hypot(now.velocity_north_mps, now.velocity_east_mps) <= ARRIVAL_SPEED_MPS
    )
