"""The scenario: who flies, who is served, over which ground, for how long.

Positions are east/north metres from `Scenario.origin`; altitude is metres above each vehicle's own home.
Every rule is checked where the object is made, and the message names the field, its value and the rule.
"""

from __future__ import annotations

from itertools import combinations
from math import hypot
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

Real = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Positive = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0)]
NonNegative = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0)]
Coordinate = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-100_000, le=100_000)]
Point = tuple[Coordinate, Coordinate]
"""East, north in metres from the origin; beyond 100 km a flat local frame is no longer honest."""

Identifier = Annotated[str, Field(strict=True, pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$")]


class Frozen(BaseModel):
    """Immutable, keyword-only, and strict about unknown fields."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Origin(Frozen):
    """Where (0, 0) of the local east/north frame lies on the WGS-84 ellipsoid, degrees."""

    lat_deg: Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-85, le=85)]
    lon_deg: Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-180, le=180)]


class Uav(Frozen):
    """One flying base station: `q_0u`, `D_max`, `B_u` and `p_u` of the letter."""

    id: Identifier
    start_m: Point
    max_speed_mps: Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0, le=100)] = 5.0
    bandwidth_hz: Positive = 10_000.0
    transmit_power_w: Positive = 0.1


class User(Frozen):
    """One quasi-static user on the ground: `c_k` of the letter. It may stand outside the flying area."""

    id: Identifier
    position_m: Point


class Channel(Frozen):
    """Rician air-to-ground channel, eqs. (1)-(2).

    `fading="mean"` sets the small-scale gain |h|^2 to 1; `"sampled"` draws it per (uav, user, slot) from `seed`.
    """

    reference_gain_db: Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-200, le=100)] = -20.0
    noise_dbm: Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-250, le=100)] = -80.0
    rician_k_db: Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-100, le=100)] = 3.0
    fading: Literal["mean", "sampled"] = "mean"
    seed: Annotated[int, Field(strict=True, ge=0, lt=2**63)] = 0


class Utility(Frozen):
    """What is maximised. `mu_per_kbps` = -2 beta in 1/(kbit/s): 0 is pure sum rate, more negative is steadier."""

    kind: Literal["sum", "per_user", "pooled"] = "sum"
    mu_per_kbps: Annotated[float, Field(strict=True, allow_inf_nan=False, le=0, ge=-1e6)] = 0.0


class Scenario(Frozen):
    """A planning problem, constraints (6a)-(6g) of the letter.

    `D_max` of eq. (6d) is `max_speed_mps * slot_duration_s` of each UAV; `D_min` of eq. (6e) is `min_separation_m`.
    """

    origin: Origin
    area_m: tuple[Point, Point]
    slots: Annotated[int, Field(strict=True, ge=1, le=100_000)]
    slot_duration_s: Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0, le=3600)]
    altitude_m: Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0, le=20_000)]
    min_separation_m: Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0, le=10_000)]
    uavs: Annotated[tuple[Uav, ...], Field(min_length=1)]
    users: Annotated[tuple[User, ...], Field(min_length=1)]
    channel: Channel = Channel()
    utility: Utility = Utility()

    @model_validator(mode="after")
    def _check(self) -> Self:
        (west, south), (east, north) = self.area_m
        if not (west < east and south < north):
            raise ValueError(
                f"area_m: {self.area_m} must be [[west, south], [east, north]] with west < east and south < north"
            )
        _require_unique("uavs", [uav.id for uav in self.uavs])
        _require_unique("users", [user.id for user in self.users])
        for index, uav in enumerate(self.uavs):
            e, n = uav.start_m
            if not (west <= e <= east and south <= n <= north):
                raise ValueError(f"uavs.{index}.start_m: {uav.start_m} of '{uav.id}' lies outside area_m {self.area_m}")
        for a, b in combinations(self.uavs, 2):
            apart = hypot(a.start_m[0] - b.start_m[0], a.start_m[1] - b.start_m[1])
            if apart < self.min_separation_m:
                raise ValueError(
                    f"uavs: start_m of '{a.id}' and '{b.id}' are {apart:.3g} m apart, closer than "
                    f"min_separation_m {self.min_separation_m:g} (eq. 6e)"
                )
        return self

    @property
    def uav_ids(self) -> tuple[str, ...]:
        """Ids in planning order: axis 0 of every (n_uavs, ...) array."""
        return tuple(uav.id for uav in self.uavs)

    @property
    def user_ids(self) -> tuple[str, ...]:
        """Ids in planning order: the user axis of every array."""
        return tuple(user.id for user in self.users)

    def with_changes(self, **changes: Any) -> Self:
        """A validated copy with some fields replaced."""
        fields = {name: getattr(self, name) for name in type(self).model_fields}
        return type(self)(**{**fields, **changes})


def _require_unique(field: str, ids: list[str]) -> None:
    twice = sorted({one for one in ids if ids.count(one) > 1})
    if twice:
        raise ValueError(f"{field}: ids must be unique; {', '.join(map(repr, twice))} occurs more than once")
