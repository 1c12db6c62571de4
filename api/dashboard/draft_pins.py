"""Pins of a scenario being edited: what the next plan has to keep. Pure.

A UAV hovers at its start or keeps a path that was planned before; a user keeps its UAV in all slots. Files may hold
finer pins, slot by slot, which are kept as they are.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any, Literal

from skyfolio.planner import Pins

Kind = Literal["uav", "user"]
Json = dict[str, Any]


class DraftPins:
    """The pins of a draft, by id."""

    def __init__(self, pins: Pins | None = None) -> None:
        self.pins = pins or Pins()

    @classmethod
    def of_data(cls, data: Json) -> DraftPins:
        """Return pins from stored data."""
        return cls(Pins.model_validate(data))

    def data(self) -> Json:
        """Return them as JSON."""
        return self.pins.model_dump(mode="json")

    def hover(self, uav_id: str) -> None:
        """Pin a UAV to its start."""
        self.release("uav", uav_id)
        self._set(uavs=(*self.pins.uavs, uav_id))

    def keep_path(self, uav_id: str, path_m: Sequence[tuple[float, float]]) -> None:
        """Pin a UAV to a path, (N, 2) metres."""
        self.release("uav", uav_id)
        self._set(paths_m={**self.pins.paths_m, uav_id: tuple(path_m)})

    def serve(self, user_id: str, uav_id: str) -> None:
        """Pin a user to a UAV in all slots."""
        self._set(associations={**self.pins.associations, user_id: uav_id})

    def release(self, kind: Kind, entry_id: str) -> None:
        """Free the path of a UAV, or a user; one that is free stays so."""
        if kind == "user":
            self._set(associations={user: row for user, row in self.pins.associations.items() if user != entry_id})
            return
        self._set(
            uavs=tuple(uav for uav in self.pins.uavs if uav != entry_id),
            paths_m={uav: path for uav, path in self.pins.paths_m.items() if uav != entry_id},
        )

    def release_path(self, uav_id: str) -> None:
        """Free a UAV that was pinned to a path, since it no longer starts there; one that hovers is still pinned."""
        if uav_id in self.pins.paths_m:
            self.release("uav", uav_id)

    def keep_only(self, uav_ids: Collection[str], user_ids: Collection[str]) -> None:
        """Drop the pins of UAVs and users that are no longer in the scenario."""
        for uav in set(self.pins.pinned_uavs) - set(uav_ids):
            self.release("uav", uav)
        for user, row in list(self.pins.associations.items()):
            servers = {row} if isinstance(row, str) else {uav for uav in row if uav}
            if user not in user_ids or not servers <= set(uav_ids):
                self.release("user", user)

    def _set(self, **fields: Any) -> None:
        self.pins = self.pins.model_copy(update=fields)


def rows(pins: Pins) -> list[tuple[Kind, str, str]]:
    """Return what is pinned: the kind, the id, and to what, in words."""
    uavs: list[tuple[Kind, str, str]] = [("uav", uav, "flies a given path") for uav in pins.paths_m]
    uavs += [("uav", uav, "hovers at its start") for uav in pins.uavs]
    return [*uavs, *(("user", user, f"is served by {servers(row)}") for user, row in pins.associations.items())]


def servers(row: str | Sequence[str | None]) -> str:
    """Return who serves a pinned user, in words."""
    if isinstance(row, str):
        return row
    named = [uav for uav in row if uav]
    return f"{', '.join(dict.fromkeys(named))} in {len(named)} of {len(row)} slots"
