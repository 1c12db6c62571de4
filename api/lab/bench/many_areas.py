"""What many areas need, calculated from what `bench scale` has measured and from assumptions that are written down.

    demand_of(measured_of(figures), Assumed(areas=100))

Nothing is measured here: other figures, or other assumptions, give other demands. Rates that are measured on one
machine are taken for those of the machines that are to be used.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, floor
from typing import Any

SYSTEM_IDS = 250
"""Vehicles on one link at most: MAVLink has 255 system ids, and ground stations need some."""
UDP_BYTES = 28
"""Head of a datagram; each frame travels in one of its own."""
HOUR_S, DAY_S = 3600.0, 86_400.0


@dataclass(frozen=True, kw_only=True)
class Assumed:
    """What was not measured.

    uavs: of one area; areas do not interfere with each other. plans_per_hour: how often an area is planned anew.
    losses_per_uav_hour: in a normal hour. contingencies_every_s: how often the plans ahead of every single loss are
    made again. worst_lost: the share of all UAVs that is lost in the worst hour; worst_plans_per_hour: plans of each
    area in it. burst_s: within this all areas must be able to be planned anew at once. subscribers: of each area.
    service_filled, workers_filled: the share of a core that a service's process, or a solving one, is to be busy on
    average. keep_days: how long events and tracks are kept.
    """

    areas: int = 100
    uavs: int = 50
    plans_per_hour: float = 2.0
    losses_per_uav_hour: float = 0.002
    contingencies_every_s: float = 60.0
    worst_lost: float = 0.1
    worst_plans_per_hour: float = 6.0
    burst_s: float = 60.0
    subscribers: int = 10
    service_filled: float = 0.5
    workers_filled: float = 0.7
    keep_days: float = 90.0


@dataclass(frozen=True, kw_only=True)
class Measured:
    """What is measured; shares are of one core, `_each` is for each UAV.

    fixed_share, share_each: of a service's process, as a line over the number of its UAVs. subscriber_share: of one
    subscriber to an area's telemetry. commits_per_s_each_operation: what a flight stores. events_per_s: what one
    database takes.
    """

    fixed_share: float
    share_each: float
    subscriber_share: float
    service_mb: float
    worker_mb: float
    telemetry_bytes_per_s_each: float
    telemetry_messages_per_s_each: float
    plan_cpu_s: float
    replan_cpu_s: float
    slot_s: float
    commits_per_s_each_operation: float
    events_per_uav_hour: float
    bytes_per_uav_hour: float
    events_per_s: float


@dataclass(frozen=True, kw_only=True)
class Demand:
    """What is needed. service_share: of a core, of each service's process.

    dask_*: workers of one core each, for what is solved for clients and for contingencies: in a normal hour, in the
    worst hour, to plan all areas anew within `burst_s`, and to renew all contingencies in every slot.
    cores, memory_gb: of services, their solvers of replans in flight, and Dask in the worst hour or burst.
    """

    uavs: int
    areas_per_service: int
    services: int
    processes: int
    service_share: float
    telemetry_mbit_s: float
    telemetry_mbit_s_each_service: float
    commits_per_s: float
    events_per_s: float
    events_per_day: float
    share_of_one_database: float
    stored_gb_per_day: float
    stored_gb: float
    dask_normal: int
    dask_worst_hour: int
    dask_burst: int
    dask_every_slot: int
    cores: int
    memory_gb: float


def demand_of(measured: Measured, assumed: Assumed) -> Demand:
    """Return what so many areas need. Raises ValueError for an assumption that makes no sense, naming it."""
    _require_sensible(assumed)
    uavs = assumed.areas * assumed.uavs
    per_area = assumed.uavs * measured.share_each + assumed.subscribers * measured.subscriber_share
    room = (assumed.service_filled - measured.fixed_share) / per_area
    together = max(1, min(floor(room), SYSTEM_IDS // assumed.uavs, assumed.areas))
    services = ceil(assumed.areas / together)
    service_share = measured.fixed_share + together * per_area
    bits_each = 8 * (measured.telemetry_bytes_per_s_each + UDP_BYTES * measured.telemetry_messages_per_s_each)
    events_per_s = uavs * measured.events_per_uav_hour / HOUR_S
    stored_gb_per_day = uavs * measured.bytes_per_uav_hour * DAY_S / HOUR_S / 1e9
    normal, worst, burst, every_slot = _workers(measured, assumed, uavs)
    dask = max(normal, worst, burst)
    return Demand(
        uavs=uavs,
        areas_per_service=together,
        services=services,
        processes=2 * services + dask,
        service_share=service_share,
        telemetry_mbit_s=uavs * bits_each / 1e6,
        telemetry_mbit_s_each_service=together * assumed.uavs * bits_each / 1e6,
        commits_per_s=assumed.areas * measured.commits_per_s_each_operation,
        events_per_s=events_per_s,
        events_per_day=events_per_s * DAY_S,
        share_of_one_database=events_per_s / measured.events_per_s,
        stored_gb_per_day=stored_gb_per_day,
        stored_gb=stored_gb_per_day * assumed.keep_days,
        dask_normal=normal,
        dask_worst_hour=worst,
        dask_burst=burst,
        dask_every_slot=every_slot,
        cores=ceil(services * service_share / assumed.service_filled) + services + dask,
        memory_gb=(services * (measured.service_mb + measured.worker_mb) + dask * measured.worker_mb) / 1024,
    )


def _workers(measured: Measured, assumed: Assumed, uavs: int) -> tuple[int, int, int, int]:
    """Return how many workers a normal hour, the worst hour, a burst, and contingencies of every slot need."""

    def workers(core_s: float, within_s: float = HOUR_S) -> int:
        return ceil(core_s / within_s / assumed.workers_filled)

    def hour(plans: float, losses: float) -> float:
        """Return core seconds; after a loss all contingencies of its area are made again."""
        renewed = uavs * HOUR_S / assumed.contingencies_every_s + losses * assumed.uavs
        return assumed.areas * plans * measured.plan_cpu_s + renewed * measured.replan_cpu_s

    return (
        workers(hour(assumed.plans_per_hour, uavs * assumed.losses_per_uav_hour)),
        workers(hour(assumed.worst_plans_per_hour, uavs * assumed.worst_lost)),
        workers(assumed.areas * measured.plan_cpu_s, assumed.burst_s),
        workers(uavs * measured.replan_cpu_s, measured.slot_s),
    )


def measured_of(figures: dict[str, Any]) -> Measured:
    """Return what the calculation needs of the figures of `bench scale`."""
    service, area = figures["service"], figures["area"]
    shares = [(row["vehicles"], row["share_of_one_core"]) for row in service["flying"] or service["bridge"]]
    fixed, each = line_through(shares)
    streams, link, flight = service["streams"][0], service["bridge"][-1], service["flights"][-1]
    listened = max(0.0, streams["share_of_one_core"] - fixed - each * streams["vehicles"]) / streams["subscribers"]
    return Measured(
        fixed_share=fixed,
        share_each=each,
        subscriber_share=listened,
        service_mb=max(row["memory_mb"] for row in (*service["flying"], *service["streams"])),
        worker_mb=area["peak_mb"],
        telemetry_bytes_per_s_each=link["bytes_per_s"],
        telemetry_messages_per_s_each=link["messages_per_s"],
        plan_cpu_s=area["plan_cpu_s"],
        replan_cpu_s=area["replan_cpu_s"],
        slot_s=area["slot_s"],
        commits_per_s_each_operation=flight["commits_per_s"],
        events_per_uav_hour=flight["events_per_uav_hour"],
        bytes_per_uav_hour=flight["bytes_per_uav_hour"],
        events_per_s=service["events"][-1]["per_s"],
    )


def line_through(points: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Return height at 0 and slope of the line of least squares, neither below 0; the slope alone for one point."""
    mean_x = sum(x for x, _ in points) / len(points)
    mean_y = sum(y for _, y in points) / len(points)
    spread = sum((x - mean_x) ** 2 for x, _ in points)
    slope = sum((x - mean_x) * (y - mean_y) for x, y in points) / spread if spread else mean_y / mean_x
    height = mean_y - slope * mean_x
    return (height, slope) if height >= 0.0 and slope >= 0.0 else (0.0, mean_y / mean_x)


def _require_sensible(assumed: Assumed) -> None:
    for name, value in vars(assumed).items():
        may_be_0 = name in {
            "plans_per_hour",
            "losses_per_uav_hour",
            "worst_lost",
            "worst_plans_per_hour",
            "subscribers",
        }
        if value < 0 or (value == 0 and not may_be_0):
            raise ValueError(f"{name}: {value} must be {'at least' if may_be_0 else 'more than'} 0")
    for name in ("service_filled", "workers_filled", "worst_lost"):
        if getattr(assumed, name) > 1:
            raise ValueError(f"{name}: {getattr(assumed, name)} must be at most 1")
    if assumed.uavs > SYSTEM_IDS:
        raise ValueError(f"uavs: {assumed.uavs} of one area are more than one link carries ({SYSTEM_IDS})")
