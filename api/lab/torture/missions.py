"""What is really on board of simulated vehicles, and whether the service has assigned it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from sqlalchemy import select

from skyfolio.api.flights.assigned_missions import AssignedMission
from skyfolio.api.lab.torture.sightings import Stored
from skyfolio.api.lab.torture.watch import Seen
from skyfolio.api.store.tables import assigned_missions as table
from skyfolio.mavlink_bridge import Autopilot, MissionItem, mission_differences
from skyfolio.sim.station import Vehicle


def on_board_of(items: Iterable[Any]) -> tuple[MissionItem, ...]:
    """Return the items on board of a vehicle, which are given as the simulator has them."""
    return tuple(
        MissionItem(
            **{name: getattr(item, name) for name in ("seq", "frame", "command", "current", "autocontinue")},
            **{name: getattr(item, name) for name in ("param1", "param2", "param3", "param4", "x", "y", "z")},
        )
        for item in items
    )


def has_a_strange_mission(seen: Seen, vehicle: Vehicle) -> bool:
    """Return whether a vehicle has a mission on board that the service has not assigned to it."""
    return bool(vehicle.mission.items) and assigned_mission(seen, vehicle) is None


def is_strange(seen: Seen, vehicle: Vehicle, stored: Stored) -> bool:
    """Return whether a vehicle has stored a mission that the service has not assigned to it."""
    return bool(stored.items) and _assigned_of(seen, vehicle, stored.mission_id, stored.items) is None


def assigned_mission(seen: Seen, vehicle: Vehicle) -> AssignedMission | None:
    """Return the assigned mission that a vehicle has on board; None if there is none, or it is none of the service."""
    if not vehicle.mission.items:
        return None
    return _assigned_of(seen, vehicle, vehicle.mission.mission_id, vehicle.mission.items)


def _assigned_of(seen: Seen, vehicle: Vehicle, mission_id: int, of_vehicle: Sequence[Any]) -> AssignedMission | None:
    key = (vehicle.system_id, mission_id, len(of_vehicle))
    if key not in seen.known_missions:
        autopilot, items = Autopilot(vehicle.spec.autopilot), on_board_of(of_vehicle)
        for mission in reversed(_assigned(seen, seen.uav_of(vehicle.system_id))):
            if not mission_differences(mission.mission.items, items, autopilot=autopilot):
                seen.known_missions[key] = mission
                break
    return seen.known_missions.get(key)


def _assigned(seen: Seen, uav: str) -> list[AssignedMission]:
    """Return what the database has, or a local file holds for it, and what the service that lives has in memory."""
    query = select(table.c.document).where(table.c.uav_id == uav)
    with seen.ground.disk.engine.connect() as connection:
        stored = [AssignedMission.of_document(row.document) for row in connection.execute(query)]
    waiting = [row["document"] for row in seen.ground.disk.held_rows(table.name) if row["uav_id"] == uav]
    stored += map(AssignedMission.of_document, waiting)
    service = seen.ground.service
    operation = None if service is None else service.operations.active(service.operations.owners().get(uav, ""))
    held = () if operation is None else operation.flight.guidance.may_fly(uav)
    return [*stored, *held]
