"""What is really on board of simulated vehicles, and whether the service has assigned it."""

from __future__ import annotations

from collections.abc import Sequence

from sqlalchemy import select

from skyfolio.api.flights.assigned_missions import AssignedMission
from skyfolio.api.lab.torture.watch import Seen
from skyfolio.api.store.tables import assigned_missions as table
from skyfolio.mavlink_bridge import Autopilot, MissionItem, mission_differences
from skyfolio.sim.station import Vehicle


def on_board_of(vehicle: Vehicle) -> tuple[MissionItem, ...]:
    """Return the items on board of a vehicle."""
    return tuple(
        MissionItem(
            **{name: getattr(item, name) for name in ("seq", "frame", "command", "current", "autocontinue")},
            **{name: getattr(item, name) for name in ("param1", "param2", "param3", "param4", "x", "y", "z")},
        )
        for item in vehicle.mission.items
    )


def strangers(seen: Seen, vehicle: Vehicle, items: Sequence[MissionItem]) -> bool:
    """Return whether no mission that the service has assigned to this vehicle has these items."""
    key = (vehicle.system_id, vehicle.mission.mission_id, len(items))
    if key in seen.known_missions:
        return False
    autopilot = Autopilot(vehicle.spec.autopilot)
    for mission in _assigned(seen, seen.ground.scenario.uav_ids[vehicle.system_id - 1]):
        if not mission_differences(mission.mission.items, items, autopilot=autopilot):
            seen.known_missions.add(key)
            return False
    return True


def _assigned(seen: Seen, uav: str) -> list[AssignedMission]:
    """Return what is on the disk, and what the service that lives still holds in memory."""
    query = select(table.c.document).where(table.c.operation_id == seen.operation_id, table.c.uav_id == uav)
    with seen.ground.disk.engine.connect() as connection:
        stored = [AssignedMission.of_document(row.document) for row in connection.execute(query)]
    service = seen.ground.service
    operation = None if service is None else service.operations.active(seen.operation_id)
    held = () if operation is None else operation.flight.guidance.may_fly(uav)
    return [*stored, *held]
