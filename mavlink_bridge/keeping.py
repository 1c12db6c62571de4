"""Keep vehicles that fly missions on schedule. All times are fleet time.

`keep` looks at each vehicle ten times a fleet second and sends the orders of its keeper.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

from skyfolio.mavlink_bridge.autopilots import FlightMode
from skyfolio.mavlink_bridge.confirming import is_ours
from skyfolio.mavlink_bridge.deviations import AltitudeWatch, Deviation, HomeWatch
from skyfolio.mavlink_bridge.flight import set_current
from skyfolio.mavlink_bridge.keeper import Keeper, Order
from skyfolio.mavlink_bridge.slip import Slip
from skyfolio.mavlink_bridge.speeds import order_speed, require_in_mission, restore_speed
from skyfolio.mavlink_bridge.telemetry import Telemetry
from skyfolio.mavlink_bridge.vehicle import NotDone, Vehicle
from skyfolio.planner.geodesy import geodetic_to_east_north
from skyfolio.planner.scenario import Origin

LOOK_S = 0.1
"""Fleet seconds between two looks of the keeper."""
SHORTEST_SLEEP_S = 0.005
"""Wall seconds; a fleet whose clock runs much faster than this is looked at less often."""
FRESH_S = 2.0
"""A position older than this (fleet seconds) is not used to steer."""


@dataclass(frozen=True, kw_only=True)
class Kept:
    """One vehicle under a keeper; `origin` is where its plan's (0, 0) lies. `altitude`, `home`: what is watched."""

    vehicle: Vehicle
    keeper: Keeper
    origin: Origin
    altitude: AltitudeWatch | None = None
    home: HomeWatch | None = None

    def is_on_board(self) -> bool:
        """Return whether the vehicle is proven to have the mission that is kept."""
        return self.vehicle.on_board == self.keeper.mission.items


OnSlip = Callable[[int, Slip], None]
OnOrder = Callable[[int, Order], None]
OnDeviation = Callable[[int, Deviation], None]


async def keep(
    kept: Mapping[int, Kept],
    *,
    elapsed_s: Callable[[], float],
    now_s: Callable[[], float],
    scale: float,
    on_slip: OnSlip,
    on_order: OnOrder = lambda _system_id, _order: None,
    on_deviation: OnDeviation = lambda _system_id, _deviation: None,
) -> None:
    """Keep vehicles on schedule until cancelled.

    elapsed_s: fleet seconds since slot 0 of their plans. now_s: the fleet's clock. scale: fleet seconds per wall
    second. on_slip(system_id, slip): called once for each vehicle and slot; on_order: for each order sent;
    on_deviation: when the altitude or the home of a vehicle is not as planned.
    """
    giving: dict[int, asyncio.Task[None]] = {}
    try:
        while True:
            for system_id, watched in kept.items():
                order, slip, deviations = _look(watched, elapsed_s(), now_s())
                if slip is not None:
                    on_slip(system_id, slip)
                for deviation in deviations:
                    on_deviation(system_id, deviation)
                if order is None:
                    continue
                if system_id in giving and not giving[system_id].done():
                    watched.keeper.not_taken(order)
                    continue
                on_order(system_id, order)
                giving[system_id] = asyncio.create_task(_give(watched, order))
            await asyncio.sleep(max(LOOK_S / scale, SHORTEST_SLEEP_S))
    finally:
        for task in giving.values():
            task.cancel()
        await asyncio.gather(*giving.values(), return_exceptions=True)


def _look(watched: Kept, elapsed_s: float, now_s: float) -> tuple[Order | None, Slip | None, list[Deviation]]:
    snapshot = watched.vehicle.state.snapshot()
    if snapshot is None or snapshot.place_deg is None or now_s - snapshot.heard_at_s > FRESH_S:
        return None, None, []
    age_s = now_s - snapshot.heard_at_s
    velocity = (snapshot.velocity_east_mps, snapshot.velocity_north_mps)
    east, north = geodetic_to_east_north(watched.origin, *snapshot.place_deg)
    point = (east + velocity[0] * age_s, north + velocity[1] * age_s)
    order = None
    if snapshot.mode is FlightMode.MISSION and snapshot.mission_current is not None:
        order = watched.keeper.advise(elapsed_s, point, velocity, snapshot.mission_current)
    return order, watched.keeper.slip(elapsed_s, point), list(_deviations(watched, snapshot, elapsed_s))


def _deviations(watched: Kept, snapshot: Telemetry, elapsed_s: float) -> Iterator[Deviation]:
    """Yield deviations: of altitude while the vehicle is ours and slots are flown, of its home whenever it moves."""
    state = watched.vehicle.state
    home = None if watched.home is None else watched.home.look(state.home_deg, state.home_amsl_m)
    if home is not None:
        yield home
    if watched.altitude is not None and is_ours(watched.vehicle) and 0 <= elapsed_s < watched.keeper.ends_s:
        altitude = watched.altitude.look(elapsed_s, snapshot.relative_alt_m, snapshot.altitude_amsl_m)
        if altitude is not None:
            yield altitude


async def _give(watched: Kept, order: Order) -> None:
    """Send an order to a vehicle that is seen in its mission just now; if it fails, a later look sends it again.

    An item is one of the mission that is kept: in another, which is sent meanwhile, its number may be the landing.
    """
    try:
        if order.item is not None:
            await require_in_mission(watched.vehicle)
            await set_current(watched.vehicle, order.item, may=watched.is_on_board)
        elif order.its_own_speed:
            await restore_speed(watched.vehicle, order.speed_mps or watched.keeper.model.cruise_mps)
        elif order.speed_mps is not None:
            await order_speed(watched.vehicle, order.speed_mps)
    except NotDone:
        watched.keeper.not_taken(order)
