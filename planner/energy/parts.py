"""What a scenario says of wind, rotors and batteries; all of it optional."""

from __future__ import annotations

from typing import Annotated

from pydantic import ConfigDict, Field, model_validator

from skyfolio.planner.parts import Frozen, Placed, Point, PositionDeg, either, in_degrees

Mps = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-100, le=100)]
Speed = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0, le=1000)]
MOST_WH = 1e6
WattHours = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0, le=MOST_WH)]
Power = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0, le=1e6)]


class Wind(Frozen):
    """The air over the field, m/s: where the steady wind blows to, and how far from it the wind may be at any time.

    `gust_mps` is a bound in every direction: what is proven holds for every wind within it. For a Gaussian gust take
    three times the spread of one axis.
    """

    east_mps: Mps = 0.0
    north_mps: Mps = 0.0
    gust_mps: Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0, le=100)] = 0.0


class Rotors(Frozen):
    """Electrical power of a rotary wing over its airspeed V, m/s.

    Y. Zeng, J. Xu, R. Zhang, "Energy minimization for wireless communication with rotary-wing UAV", IEEE Trans.
    Wireless Commun. 18(4), 2019, eq. (6): P(V) = blade_w (1 + 3 V^2 / tip_mps^2) + induced_w sqrt(sqrt(1 + r^2) - r)
    + parasite_w_per_mps3 V^3, with r = V^2 / (2 induced_mps^2). The defaults are those of its Table I (2 kg): replace
    them by what a vehicle's own telemetry gives.
    blade_w, induced_w: W, at hover; electronics count as blade_w. tip_mps: of the blades. induced_mps: mean induced
    velocity at hover. parasite_w_per_mps3: half the air density times the drag area. climb_w_per_mps: W for each m/s
    of climb (mass times gravity, over the efficiency). climb_mps, descend_mps: at which it climbs to its altitude and
    comes down again, on average.
    """

    blade_w: Power = 79.86
    tip_mps: Speed = 120.0
    induced_w: Power = 88.63
    induced_mps: Speed = 4.03
    parasite_w_per_mps3: Power = 0.00924
    climb_w_per_mps: Power = 19.62
    climb_mps: Speed = 2.0
    descend_mps: Speed = 1.0

    @model_validator(mode="after")
    def _check(self) -> Rotors:
        if self.blade_w + self.induced_w <= 0.0:
            raise ValueError("blade_w, induced_w: one of them must be above 0, or hovering would cost nothing")
        return self


class Battery(Frozen):
    """What a UAV may spend. `usable_wh`: Wh in a full battery; `reserve_share` of them is never planned with.

    used_wh: what has been used when the plan begins, of a UAV that is in the air by then; None for one that starts on
    the ground with all of it, and has to climb first.
    """

    usable_wh: WattHours
    reserve_share: Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0, lt=1)] = 0.2
    used_wh: Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0, le=MOST_WH)] | None = None

    @property
    def budget_wh(self) -> float:
        """What may be spent until it has landed, Wh from a full battery on."""
        return self.usable_wh * (1.0 - self.reserve_share)


class RallyPoint(Placed):
    """A place at which UAVs may land instead of their home; metres."""

    model_config = ConfigDict(json_schema_extra=either(("position_m",), ("position_deg",)))

    position_m: Point
    position_deg: PositionDeg | None = in_degrees("Where it is, degrees; may be given instead of `position_m`.")
