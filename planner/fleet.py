"""The UAVs of a scenario."""

from __future__ import annotations

from typing import Annotated

from pydantic import ConfigDict, Field

from skyfolio.planner.altitudes import Altitude, Amsl, ClimbRate
from skyfolio.planner.energy.parts import Battery, Rotors
from skyfolio.planner.parts import Identifier, Placed, Point, PositionDeg, either, in_degrees, left_out

Hertz = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=1, le=1e11)]
Watts = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=1e-12, le=1e6)]


class Uav(Placed):
    """One flying base station: `q_0u`, `D_max`, `B_u` and `p_u` of the letter.

    Beyond the letter, each optional: `altitude_m` of its own, metres above its home; `end_m`, where it must be in its
    last slot; `leaves_at_slot`, the slot (counted from 0) from which on it is gone, a battery's end known beforehand;
    `max_airspeed_mps`, its limit through the air where there is wind (default: `max_speed_mps`); `battery`, with which
    it must come home from every slot, to `home_m` (default: its start) or the cheapest of the `rally_points`; `rotors`,
    what flying costs it; `on_air_from_slot` and `off_air_from_slot`, when its base station sends: one that comes to
    relieve another is silent until it takes over.
    """

    model_config = ConfigDict(json_schema_extra=either(("start_m",), ("start_deg",)))

    id: Identifier
    start_m: Point
    max_speed_mps: Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0, le=100)] = 5.0
    bandwidth_hz: Hertz = 10_000.0
    transmit_power_w: Watts = 0.1
    altitude_m: Altitude | None = None
    end_m: Point | None = None
    leaves_at_slot: Annotated[int, Field(strict=True, ge=1)] | None = None
    start_deg: PositionDeg | None = in_degrees("Where it starts, degrees; may be given instead of `start_m`.")
    end_deg: PositionDeg | None = in_degrees("Where it must end, degrees; may be given instead of `end_m`.")
    altitude_min_m: Altitude | None = left_out("Instead of the scenario's `altitude_min_m`.")
    altitude_max_m: Altitude | None = left_out("Instead of the scenario's `altitude_max_m`.")
    max_climb_mps: ClimbRate | None = left_out("How fast it climbs and descends, m/s; default 1.5.")
    start_altitude_m: Amsl | None = left_out(
        "Its altitude in slot 0 if it flies already, metres above sea level (without terrain: above home)."
    )
    max_airspeed_mps: Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0, le=200)] | None = left_out(
        "Through the air, m/s; what it reaches over ground depends on the wind."
    )
    battery: Battery | None = left_out("What it may use; without it, energy is no limit.")
    rotors: Rotors | None = left_out("What flying costs it; without it, a common quadcopter's.")
    on_air_from_slot: Annotated[int, Field(strict=True, ge=0)] | None = left_out(
        "The slot, counted from 0, from which on its base station sends: before, it serves and disturbs no user."
    )
    off_air_from_slot: Annotated[int, Field(strict=True, ge=0)] | None = left_out(
        "The slot, counted from 0, from which on its base station no longer sends."
    )
    home_m: Point | None = left_out("Where it lands, if that is not `start_m`: its ways home end there.")
    home_deg: PositionDeg | None = in_degrees("Where it lands, degrees; may be given instead of `home_m`.")
