"""Missions that UAVs were given, stored so that a restarted service knows what it finds on board."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from math import isnan
from typing import Any

from sqlalchemy import Row, insert, select

from skyfolio.api.flights.rates import Point
from skyfolio.api.store import Database
from skyfolio.api.store.tables import given as table
from skyfolio.mavlink_bridge import Autopilot, Mission, MissionItem
from skyfolio.planner import Origin

_INSERT = insert(table)


@dataclass(frozen=True, kw_only=True)
class AssignedMission:
    """A mission and the path it was made from.

    path_m: (n, 2) metres east/north of `origin`, where the UAV shall be when slots `first_slot`, `first_slot` + 1, ...
    of the operation begin, each slot_s fleet seconds long. altitude_m: above its own home.
    """

    mission: Mission
    path_m: list[Point]
    first_slot: int
    slot_s: float
    origin: Origin
    altitude_m: float

    @property
    def began_s(self) -> float:
        """Fleet seconds from slot 0 of the operation to the first point."""
        return self.first_slot * self.slot_s

    def document(self) -> str:
        """As JSON."""
        mission = self.mission
        return json.dumps(
            {
                **{name: getattr(self, name) for name in ("path_m", "first_slot", "slot_s", "altitude_m")},
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
        """What `document` wrote."""
        said = json.loads(document)
        mission = said["mission"]
        items = tuple(MissionItem(**_with_nan(item)) for item in mission["items"])
        slots = {int(seq): slot for seq, slot in mission["slot_of_item"].items()}
        made = Mission(
            **{**mission, "items": items, "slot_of_item": slots, "autopilot": Autopilot(mission["autopilot"])}
        )
        path = [(east, north) for east, north in said["path_m"]]
        return cls(**{**said, "mission": made, "path_m": path, "origin": Origin(**said["origin"])})


class AssignedMissionStore:
    """The missions of one operation, in the order in which they were given."""

    def __init__(self, database: Database, operation_id: str) -> None:
        self._database, self._operation_id = database, operation_id

    async def write(self, given: Mapping[str, AssignedMission]) -> None:
        """Store that these UAVs are about to be given these; held while the database does not answer."""
        if given:
            await self._database.keep((_INSERT, await asyncio.to_thread(self._rows, dict(given))))

    async def read(self) -> dict[str, list[AssignedMission]]:
        """For each UAV what it was given, the newest first. Raises StoreError."""
        wanted = select(table).where(table.c.operation_id == self._operation_id).order_by(table.c.id.desc())
        return await asyncio.to_thread(_by_uav, await self._database.rows(wanted))

    def _rows(self, given: Mapping[str, AssignedMission]) -> list[dict[str, str]]:
        """What is stored of these; runs beside the event loop, which a large fleet's would hold up."""
        return [
            {"operation_id": self._operation_id, "uav_id": uav, "document": one.document()}
            for uav, one in given.items()
        ]


def _by_uav(rows: Iterable[Row[Any]]) -> dict[str, list[AssignedMission]]:
    """Return what each UAV was given, in the order of the rows."""
    found: dict[str, list[AssignedMission]] = {}
    for row in rows:
        found.setdefault(row.uav_id, []).append(AssignedMission.of_document(row.document))
    return found


def _without_nan(item: dict[str, Any]) -> dict[str, Any]:
    """NaN is no JSON: null."""
    return {name: None if isinstance(value, float) and isnan(value) else value for name, value in item.items()}


def _with_nan(item: dict[str, Any]) -> dict[str, Any]:
    return {name: float("nan") if value is None else value for name, value in item.items()}
