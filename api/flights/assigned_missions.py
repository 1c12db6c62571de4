"""The missions that were assigned to UAVs, stored so that a restarted service recognises what it finds on board."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from math import isnan
from typing import Any

from sqlalchemy import Row, bindparam, delete, insert, select

from skyfolio.api.store import Database
from skyfolio.api.store.tables import assigned_missions as table
from skyfolio.mavlink_bridge import Autopilot, Mission, MissionItem
from skyfolio.mavlink_bridge.altitudes import Altitudes
from skyfolio.planner import Origin
from skyfolio.planner.geometry import Point

_INSERT = insert(table)
KEPT = 16
"""So many of the missions that were assigned to a UAV are kept: those before were replaced, and proven to be."""
_NEWEST = (
    select(table.c.id)
    .where(table.c.operation_id == bindparam("operation_id_"), table.c.uav_id == bindparam("uav_id_"))
    .order_by(table.c.id.desc())
    .offset(KEPT)
    .limit(1)
    .scalar_subquery()
)
_FORGET = delete(table).where(
    table.c.operation_id == bindparam("operation_id_"), table.c.uav_id == bindparam("uav_id_"), table.c.id <= _NEWEST
)
_PLAIN = ("path_m", "first_slot", "slot_s", "altitude_m", "altitudes_m", "amsl")


@dataclass(frozen=True, kw_only=True)
class AssignedMission:
    """A mission that was compiled for a UAV, and the path it was made from.

    path_m: (n, 2) metres east/north of `origin`, where the UAV shall be when the slots `first_slot`, `first_slot` + 1,
    ... of the operation begin, each slot_s fleet seconds long. altitude_m: above the UAV's own home, of level flight;
    otherwise altitudes_m: (n,), above mean sea level if `amsl`, and altitude_m the greatest of them.
    """

    mission: Mission
    path_m: list[Point]
    first_slot: int
    slot_s: float
    origin: Origin
    altitude_m: float
    altitudes_m: list[float] | None = None
    amsl: bool = False

    @property
    def altitudes(self) -> Altitudes:
        """Return the altitudes along the path."""
        return Altitudes(tuple(self.altitudes_m or [self.altitude_m] * len(self.path_m)), self.amsl)

    @property
    def began_s(self) -> float:
        """Return the fleet seconds from slot 0 of the operation to the first point of the path."""
        return self.first_slot * self.slot_s

    def document(self) -> str:
        """Return it as JSON."""
        mission = self.mission
        return json.dumps(
            {
                **{name: getattr(self, name) for name in _PLAIN},
                "origin": self.origin.model_dump(),
                "mission": {
                    **{name: getattr(mission, name) for name in ("uav_id", "duration_s", "start_item", "autopilot")},
                    "items": [_without_nan(asdict(item)) for item in mission.items],
                    "slot_of_item": dict(mission.slot_of_item),
                },
            }
        )

    @classmethod
    def of_document(cls, document: str) -> AssignedMission:
        """Return the assigned mission that `document` wrote."""
        stored = json.loads(document)
        mission = stored["mission"]
        items = tuple(MissionItem(**_with_nan(item)) for item in mission["items"])
        slots = {int(seq): slot for seq, slot in mission["slot_of_item"].items()}
        restored = Mission(
            **{**mission, "items": items, "slot_of_item": slots, "autopilot": Autopilot(mission["autopilot"])}
        )
        path = [(east, north) for east, north in stored["path_m"]]
        return cls(**{**stored, "mission": restored, "path_m": path, "origin": Origin(**stored["origin"])})


class AssignedMissionStore:
    """The stored missions of one operation, in the order in which they were assigned."""

    def __init__(self, database: Database, operation_id: str) -> None:
        self._database, self._operation_id = database, operation_id

    async def write(self, missions: Mapping[str, AssignedMission]) -> None:
        """Store missions that are about to be sent, by UAV; they are held while the database does not answer."""
        if missions:
            rows = await asyncio.to_thread(self._rows, dict(missions))
            old = [{"operation_id_": self._operation_id, "uav_id_": uav} for uav in missions]
            await self._database.keep(*self._database.owned(self._operation_id), (_INSERT, rows), (_FORGET, old))

    async def read(self) -> dict[str, list[AssignedMission]]:
        """Return the newest missions that were assigned to each UAV, the newest first. Raises StoreError."""
        query = select(table).where(table.c.operation_id == self._operation_id).order_by(table.c.id.desc())
        return await asyncio.to_thread(_by_uav, await self._database.rows(query))

    def _rows(self, missions: Mapping[str, AssignedMission]) -> list[dict[str, str]]:
        """Return the rows to store; runs beside the event loop, which the missions of a large fleet would block."""
        return [
            {"operation_id": self._operation_id, "uav_id": uav, "document": assigned.document()}
            for uav, assigned in missions.items()
        ]


def _by_uav(rows: Iterable[Row[Any]]) -> dict[str, list[AssignedMission]]:
    """Return the missions of each UAV in the order of the rows."""
    missions: dict[str, list[AssignedMission]] = {}
    for row in rows:
        missions.setdefault(row.uav_id, []).append(AssignedMission.of_document(row.document))
    return missions


def _without_nan(item: dict[str, Any]) -> dict[str, Any]:
    """Return the item with null for NaN, which JSON has not."""
    return {name: None if isinstance(value, float) and isnan(value) else value for name, value in item.items()}


def _with_nan(item: dict[str, Any]) -> dict[str, Any]:
    return {name: float("nan") if value is None else value for name, value in item.items()}
