"""What the map shows now: the state of the watch as spots, scene and frame."""

from __future__ import annotations

from skyfolio.api.dashboard import map_scene
from skyfolio.api.dashboard.views import Operation, Vehicle
from skyfolio.api.dashboard.watch import TrackedVehicle, Watch
from skyfolio.planner import Plan
from skyfolio.planner.energy.outlook import Outlook, outlook_of


def spots(watch: Watch) -> list[map_scene.Spot]:
    """Return every vehicle of the shown operation, or all registered ones if none is under way, by number."""
    operation, plan, elapsed = watch.operation, watch.plan_in_force(), watch.elapsed_s()
    under_way = operation is not None and not operation.ended
    found = []
    for uav, tracked in sorted(watch.vehicles.items(), key=_natural):
        if under_way and operation is not None and uav not in operation.vehicles:
            continue
        at = None if tracked.east_m is None or tracked.north_m is None else (tracked.east_m, tracked.north_m)
        lost = operation is not None and uav in operation.lost
        found.append(
            map_scene.Spot(
                uav_id=uav,
                at_m=at,
                course_deg=tracked.course_deg,
                vehicle=tracked.vehicle,
                lost=lost,
                slip=map_scene.slip_of(plan, uav, elapsed, at) if under_way and not lost else None,
                energy=energy_of(plan, uav, elapsed, tracked.vehicle) if under_way and not lost else None,
            )
        )
    return found


def energy_of(plan: Plan | None, uav: str, elapsed_s: float | None, vehicle: Vehicle | None) -> Outlook | None:
    """Return the energy of a UAV by its own gauge; None before slot 0, and where plan or vehicle do not tell of it.

    elapsed_s: since slot 0 of the operation.
    """
    if plan is None or elapsed_s is None or elapsed_s < 0 or uav not in plan.trajectories_m:
        return None
    if vehicle is None or vehicle.battery_percent is None:
        return None
    slots = elapsed_s / plan.scenario.slot_duration_s - plan.first_slot
    return outlook_of(plan, uav, slots, vehicle.battery_percent / 100.0)


def frame(watch: Watch, operation: Operation, plan: Plan, first: Plan) -> map_scene.Json:
    """Return where every UAV is, which users it serves, and what they get."""
    flying = operation.state in {"flying", "paused", "link_lost"} and operation.slot is not None
    rates: dict[str, float | None] = {}
    if flying and operation.slot is not None:
        rates = {user: _latest(row, operation.slot) for user, row in operation.user_rates_bps.items()}
    return map_scene.frame(spots(watch), plan, operation.slot if flying else None, rates, promise=first)


def scene(operation: Operation, plan: Plan, first: Plan, tile_url: str | None) -> map_scene.Json:
    """Return the area, users, the plan in force and the first one, and the air reserved for lost UAVs."""
    plans = [("former", first), ("current", plan)] if plan.id != first.id else [("current", first)]
    taken = map_scene.reserved(first, operation.lost, operation.slot or 0)
    return map_scene.scene(first.scenario, plans, reserved=taken, tiles=tile_url)


def tracks(watch: Watch) -> dict[str, list[tuple[float, float]]]:
    """Return the flown tracks of the shown operation, metres east/north."""
    return {uav: [(e, n) for _, e, n in tracked.track] for uav, tracked in watch.vehicles.items()}


def _latest(row: list[float | None], slot: int) -> float | None:
    return next((rate for rate in reversed(row[: slot + 1]) if rate is not None), None)


def _natural(item: tuple[str, TrackedVehicle]) -> tuple[str, int]:
    head, _, tail = item[0].rpartition("-")
    return (head, int(tail)) if tail.isdigit() else (item[0], 0)
