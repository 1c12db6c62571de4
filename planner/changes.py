"""The changes that an operation can adapt to by a replan."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic import Field, model_validator

from skyfolio.planner.places import Parts, with_metres
from skyfolio.planner.scenario import Frozen, Hertz, Identifier, Origin, Scenario, Uav, User, Utility

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
    staying = tuple(user.moved_on(begin, scenario.slot_duration_s) for user in scenario.users if user.id not in left)
    taken = {user.id for user in staying}
    for user in changes.users_joined:
        if user.id in taken:
            raise ReplanError(f"users_joined: {user.id!r} is already there")
    users = staying + changes.users_joined
    if not users:
        raise ReplanError("users_left: no user would be left to plan for")
    return users


def uavs_after(survivors: tuple[Uav, ...], changes: Changes) -> tuple[Uav, ...]:
    """Return the survivors and the UAVs that return, with new bands. Raises ReplanError for ids that do not fit."""
    flying = {uav.id for uav in survivors}
    for uav in changes.returned:
        if uav.id in flying:
            raise ReplanError(f"returned: {uav.id!r} is still flying")
    uavs = survivors + changes.returned
    for one in changes.bandwidth_hz:
        if one not in {uav.id for uav in uavs}:
            raise ReplanError(f"bandwidth_hz: {one!r} is not a UAV of the new plan")
    return tuple(
        uav.model_copy(update={"bandwidth_hz": changes.bandwidth_hz.get(uav.id, uav.bandwidth_hz)}) for uav in uavs
    )
