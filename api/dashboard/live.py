"""What the map shows now: the watch's state as spots, scene and frame."""

from __future__ import annotations

from skyfolio.api.dashboard import map_scene as picture
from skyfolio.api.dashboard.views import Operation
from skyfolio.api.dashboard.watch import Seen, Watch
from skyfolio.planner import Plan


def spots(watch: Watch) -> list[picture.Spot]:
    """Every vehicle of the shown operation (or of the registry, when none is under way), by the number in its name."""
    operation, plan, elapsed = watch.operation, watch.plan_in_force(), watch.elapsed_s()
    under_way = operation is not None and not operation.ended
    made = []
    for uav, seen in sorted(watch.seen.items(), key=_natural):
        if under_way and operation is not None and uav not in operation.vehicles:
            continue
        at = None if seen.east_m is None or seen.north_m is None else (seen.east_m, seen.north_m)
        lost = operation is not None and uav in operation.lost
        made.append(
            picture.Spot(
                uav_id=uav,
                at_m=at,
                course_deg=seen.course_deg,
                vehicle=seen.vehicle,
                lost=lost,
                slip_s=picture.slip_of(plan, uav, elapsed, at) if under_way and not lost else None,
            )
        )
    return made


def frame(watch: Watch, operation: Operation, plan: Plan, first: Plan) -> picture.Json:
    """Where everyone is, who serves whom, and what users get."""
    flying = operation.state in {"flying", "paused", "link_lost"} and operation.slot is not None
    rates: dict[str, float | None] = {}
    if flying and operation.slot is not None:
        rates = {user: _latest(row, operation.slot) for user, row in operation.user_rates_bps.items()}
    return picture.frame(spots(watch), plan, operation.slot if flying else None, rates, promise=first)


def scene(operation: Operation, plan: Plan, first: Plan, tile_url: str | None) -> picture.Json:
    """Area, users, the plan in force and the one before, and the air that lost UAVs keep."""
    plans = [("former", first), ("current", plan)] if plan.id != first.id else [("current", first)]
    taken = picture.reserved(first, operation.lost, operation.slot or 0)
    return picture.scene(first.scenario, plans, reserved=taken, tiles=tile_url)


def tracks(watch: Watch) -> dict[str, list[tuple[float, float]]]:
    """What was flown in the shown operation."""
    return {uav: [(e, n) for _, e, n in seen.track] for uav, seen in watch.seen.items()}


def _latest(row: list[float | None], slot: int) -> float | None:
    return next((rate for rate in reversed(row[: slot + 1]) if rate is not None), None)


def _natural(item: tuple[str, Seen]) -> tuple[str, int]:
    head, _, tail = item[0].rpartition("-")
    return (head, int(tail)) if tail.isdigit() else (item[0], 0)
