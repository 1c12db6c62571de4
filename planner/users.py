"""Users: where they are in each slot, and how far from there they may be.

A user stays at `position_m`; or follows `positions_m`, one place for each slot; or moves on from `position_m` with
`velocity_mps`. Around that place it may be anywhere within a radius that grows with time. What is planned with is the
mean squared distance to it: of a user anywhere in a disc of radius r around c alike, E|q - x|^2 = |q - c|^2 + r^2 / 2.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Self

from pydantic import ConfigDict, Field, model_validator

from skyfolio.planner.parts import (
    BitsPerSecond,
    Identifier,
    Placed,
    Point,
    PositionDeg,
    either,
    in_degrees,
    left_out,
)

Slot = Annotated[int, Field(strict=True, ge=-1_000_000, le=1_000_000)]
Speed = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-1000, le=1000)]
LARGEST_M = 100_000.0
"""A flat local frame is no longer honest beyond."""


class User(Placed):
    """One user on the ground: `c_k` of the letter, where users stay. It may be outside the flying area.

    `min_rate_bps` is what it must get in every slot, bit/s. Beyond the letter, each optional: `positions_m`, where it
    is when each slot begins; or `velocity_mps`, east and north, with which it goes on from `position_m`. It is within
    `uncertainty_m` of there in slot 0, and within `uncertainty_mps` more for each second that has passed. From
    `arrives_at_slot` on until before `leaves_at_slot` it is there: else it is not served, and such slots are not in its
    expectation. `weight`: it counts as so many users who get the same rate. `demand_bps`: what it gets beyond that in
    a slot is worth nothing, and it gets no band for it.
    """

    model_config = ConfigDict(
        json_schema_extra=either(("position_m",), ("position_deg",), ("positions_m",), ("positions_deg",))
    )

    id: Identifier
    position_m: Point
    min_rate_bps: BitsPerSecond = 0.0
    position_deg: PositionDeg | None = in_degrees("Where it is, degrees; may be given instead of `position_m`.")
    positions_m: Annotated[tuple[Point, ...], Field(min_length=1, max_length=100_000)] | None = left_out(
        "Where it is when each slot begins, metres; `position_m` is then the first of them, and may be left out."
    )
    positions_deg: Annotated[tuple[PositionDeg, ...], Field(min_length=1, max_length=100_000)] | None = in_degrees(
        "Where it is when each slot begins, degrees; may be given instead of `positions_m`."
    )
    velocity_mps: tuple[Speed, Speed] | None = left_out("East and north, m/s: how it goes on from `position_m`.")
    uncertainty_m: Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0, le=10_000)] | None = left_out(
        "Radius around its place within which it is in slot 0, metres; 0 by default."
    )
    arrives_at_slot: Slot | None = left_out(
        "The slot, counted from 0, from which on it is there; negative in a replan for one that came before."
    )
    leaves_at_slot: Slot | None = left_out("The slot, counted from 0, from which on it is gone.")
    weight: Annotated[float, Field(strict=True, allow_inf_nan=False, ge=1e-6, le=1e6)] | None = left_out(
        "As how many users it counts in the utility; 1 by default."
    )
    demand_bps: Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0, le=1e15)] | None = left_out(
        "What it asks for, bit/s: more in a slot is worth nothing; no limit by default."
    )
    uncertainty_mps: Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0, le=1000)] | None = left_out(
        "By how much that radius grows each second, m/s; 0 by default."
    )

    @model_validator(mode="before")
    @classmethod
    def _begin_on_track(cls, given: Any) -> Any:
        track = given.get("positions_m") if isinstance(given, Mapping) else None
        if track and isinstance(track, Sequence) and given.get("position_m") is None:
            return {**given, "position_m": track[0]}
        return given

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.positions_m is not None and self.velocity_mps is not None:
            raise ValueError("velocity_mps: a user has positions_m or velocity_mps, not both")
        if self.positions_m is not None and self.position_m != self.positions_m[0]:
            raise ValueError(
                f"position_m: {self.position_m} must be the first of positions_m, {self.positions_m[0]}, or left out"
            )
        came, goes = self.arrives_at_slot, self.leaves_at_slot
        if came is not None and goes is not None and goes <= came:
            raise ValueError(f"leaves_at_slot: {goes} must be greater than arrives_at_slot, {came}")
        if self.demand_bps is not None and self.demand_bps < self.min_rate_bps:
            raise ValueError(f"demand_bps: {self.demand_bps} must be at least min_rate_bps, {self.min_rate_bps}")
        return self

    @property
    def moves(self) -> bool:
        """Return whether it is not at the same place in all slots."""
        if self.positions_m is not None:
            return any(place != self.position_m for place in self.positions_m)
        return self.velocity_mps is not None and self.velocity_mps != (0.0, 0.0)

    def place_m(self, slot: int, slot_duration_s: float) -> Point:
        """Return where it is when a slot of its scenario begins, metres."""
        if self.positions_m is not None:
            return self.positions_m[slot]
        if self.velocity_mps is None:
            return self.position_m
        east, north = self.velocity_mps
        seconds = slot * slot_duration_s
        return self.position_m[0] + east * seconds, self.position_m[1] + north * seconds

    def radius_m(self, slot: int, slot_duration_s: float) -> float:
        """Return within how many metres of its place it is then."""
        return (self.uncertainty_m or 0.0) + (self.uncertainty_mps or 0.0) * slot * slot_duration_s

    def is_there(self, slot: int) -> bool:
        """Return whether it is there in a slot of its scenario; negative slots were before it."""
        came = self.arrives_at_slot is None or slot >= self.arrives_at_slot
        return came and (self.leaves_at_slot is None or slot < self.leaves_at_slot)

    def is_plain(self, slots: int) -> bool:
        """Return whether it stays where it is known to be, is there in all these slots, counts once, takes any rate."""
        stays = not (self.moves or self.uncertainty_m or self.uncertainty_mps)
        always = self.is_there(0) and self.is_there(slots - 1)
        return stays and always and self.weight in {None, 1.0} and self.demand_bps is None

    def moved_on(self, slots: int, slot_duration_s: float) -> Self:
        """Return the user as it is some slots later."""
        changes: dict[str, Any] = {}
        if self.positions_m is not None:
            changes = {"positions_m": self.positions_m[slots:], "position_m": self.positions_m[slots]}
        elif self.velocity_mps is not None and slots:
            changes = {"position_m": self.place_m(slots, slot_duration_s)}
        if self.uncertainty_mps and slots:
            changes["uncertainty_m"] = self.radius_m(slots, slot_duration_s)
        for name in ("arrives_at_slot", "leaves_at_slot"):
            at = getattr(self, name)
            if at is not None and slots:
                changes[name] = at - slots
        return self.model_copy(update=changes) if changes else self


def require_tracks(users: Sequence[User], slots: int, slot_duration_s: float) -> None:
    """Check that each track has a place for each slot, in the local frame. Raises ValueError naming field and rule."""
    for k, user in enumerate(users):
        if user.positions_m is not None and len(user.positions_m) != slots:
            raise ValueError(
                f"users.{k}.positions_m: '{user.id}' has {len(user.positions_m)} places, but there are {slots} slots"
            )
        furthest = max(map(abs, user.place_m(slots - 1, slot_duration_s)))
        if furthest > LARGEST_M:
            raise ValueError(
                f"users.{k}.velocity_mps: '{user.id}' would be {furthest:.6g} m from the origin in the last slot; "
                f"at most {LARGEST_M:g} m are planned"
            )
