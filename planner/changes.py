"""The changes that an operation can adapt to by a replan."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from operator import not_
from typing import Annotated, Any

from pydantic import Field, model_validator

from skyfolio.planner.places import Parts, with_metres
from skyfolio.planner.scenario import Frozen, Hertz, Identifier, Origin, Point, Scenario, Uav, User, Utility

Slots = Annotated[int, Field(strict=True, ge=1, le=100_000)]
SlotOfOperation = Annotated[int, Field(strict=True, ge=1, le=2_000_000)]
_PLACED: Parts = {"users_joined": ("position", "positions"), "returned": ("start", "end", "home")}


class ReplanError(ValueError):
    """The requested replan is impossible: unknown UAV, slot outside the plan, no UAV or user left."""


class Changes(Frozen):
    """Everything that changes from the first slot of a replan on.

    failed: UAVs that are gone. returned: UAVs that join or come back, whole, with `start_m` where they are then.
    users_joined, users_left: users by value and by id. A user that joins has no past: the slots before are not in its
    expectation, which counts by the share of the slots in which the user was there. One that leaves no longer counts,
    nor does what it got. utility: the new one. bandwidth_hz: the new band of some UAVs, by id. origin: the plan's; it
    is needed, and only used, where users or UAVs are given in degrees alone.
    slots: how many slots the new plan has (default: those that are left of the old one). Beyond the end of the old plan
    users go on as they move, those that follow a track stay at its last place, and UAVs with a battery leave when their
    energy lasts no longer. Of what was achieved, only the last `slots` slots then count, so that an operation without
    end has no past without end. leaves_at: the slot, on the operation's slot grid, from which on UAVs are gone, by id;
    null for one that stays. off_air_at: likewise, from which on their base stations no longer send. ends_m: where UAVs
    must be in their last slot, metres east/north, by id; null for one that may be anywhere.
    """

    failed: tuple[Identifier, ...] = ()
    returned: tuple[Uav, ...] = ()
    users_joined: tuple[User, ...] = ()
    users_left: tuple[Identifier, ...] = ()
    utility: Utility | None = None
    bandwidth_hz: dict[Identifier, Hertz] = Field(default_factory=dict)
    origin: Origin | None = Field(
        default=None,
        exclude_if=lambda value: value is None,
        description="That of the plan; needed where places are given in degrees alone.",
    )
    slots: Slots | None = Field(
        default=None,
        exclude_if=lambda value: value is None,
        description="How many slots the new plan has; default: those that are left of the old one.",
    )
    leaves_at: dict[Identifier, SlotOfOperation | None] = Field(
        default_factory=dict,
        exclude_if=not_,
        description="The slot of the operation from which on UAVs are gone, by id; null: one that stays.",
    )
    off_air_at: dict[Identifier, SlotOfOperation] = Field(
        default_factory=dict,
        exclude_if=not_,
        description="The slot of the operation from which on base stations no longer send, by id of their UAV.",
    )
    ends_m: dict[Identifier, Point | None] = Field(
        default_factory=dict,
        exclude_if=not_,
        description="Where UAVs must be in their last slot, metres east/north, by id; null: anywhere.",
    )

    @model_validator(mode="before")
    @classmethod
    def _in_metres(cls, given: Any) -> Any:
        if isinstance(given, Mapping) and given.get("origin") is None:
            return given  # metres that are missing are told by the parts themselves
        return with_metres(given, _PLACED)


def users_after(scenario: Scenario, changes: Changes, begin: int) -> tuple[User, ...]:
    """Return the users that stay, as they are `begin` slots later, then those that join.

    Raises ReplanError for wrong ids, and if none is left.
    """
    known = set(scenario.user_ids)
    for one in changes.users_left:
        if one not in known:
            raise ReplanError(f"users_left: {one!r} is not a user of the plan")
    left = set(changes.users_left)
    staying = tuple(
        _with_track(user.moved_on(begin, scenario.slot_duration_s), changes.slots)
        for user in scenario.users
        if user.id not in left
    )
    taken = {user.id for user in staying}
    for user in changes.users_joined:
        if user.id in taken:
            raise ReplanError(f"users_joined: {user.id!r} is already there")
    users = staying + changes.users_joined
    if not users:
        raise ReplanError("users_left: no user would be left to plan for")
    return users


def _with_track(user: User, slots: int | None) -> User:
    """Return the user with a track of so many slots: cut, or staying at its last place."""
    track = user.positions_m
    if track is None or slots is None or len(track) == slots:
        return user
    fitted = (*track[:slots], *[track[-1]] * (slots - len(track)))
    return user.model_copy(update={"positions_m": fitted, "position_m": fitted[0]})


def uavs_after(survivors: tuple[Uav, ...], changes: Changes, at_slot: int) -> tuple[Uav, ...]:
    """Return the survivors and the UAVs that return, with new bands, ends and slots in which they leave.

    Raises ReplanError for ids that do not fit, and for one that would leave before it begins.
    """
    flying = {uav.id for uav in survivors}
    for uav in changes.returned:
        if uav.id in flying:
            raise ReplanError(f"returned: {uav.id!r} is still flying")
    uavs = survivors + changes.returned
    known = {uav.id for uav in uavs}
    _require_known("bandwidth_hz", changes.bandwidth_hz, known)
    _require_known("leaves_at", changes.leaves_at, known)
    _require_known("ends_m", changes.ends_m, known)
    _require_known("off_air_at", changes.off_air_at, known)
    for one, slot in changes.leaves_at.items():
        if slot is not None and slot <= at_slot:
            raise ReplanError(
                f"leaves_at.{one}: {slot} must be greater than at_slot, {at_slot}; `failed` takes it away"
            )
    return tuple(_changed(uav, changes, at_slot) for uav in uavs)


def _require_known(field: str, ids: Collection[str], known: set[str]) -> None:
    for one in ids:
        if one not in known:
            raise ReplanError(f"{field}: {one!r} is not a UAV of the new plan")


def _changed(uav: Uav, changes: Changes, at_slot: int) -> Uav:
    update: dict[str, Any] = {"bandwidth_hz": changes.bandwidth_hz.get(uav.id, uav.bandwidth_hz)}
    if uav.id in changes.leaves_at:
        slot = changes.leaves_at[uav.id]
        update["leaves_at_slot"] = None if slot is None else slot - at_slot
    if uav.id in changes.off_air_at:
        update["off_air_from_slot"] = max(changes.off_air_at[uav.id] - at_slot, 0)
    if uav.id in changes.ends_m:
        update["end_m"] = changes.ends_m[uav.id]
    return uav.model_copy(update=update)
