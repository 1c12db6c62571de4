"""The figures of `bench scale` as tables for a terminal and as Markdown."""

from __future__ import annotations

from typing import Any, NamedTuple

from rich.table import Table

from skyfolio.api.lab.bench.tables import grid, on_terminal


class Grid(NamedTuple):
    """One table: what stands above it, its columns, its rows."""

    title: str
    said: str
    columns: list[str]
    rows: list[list[str]]


def tables(figures: dict[str, Any]) -> list[Table]:
    """Return the figures as tables for a terminal."""
    return [on_terminal(one.title, [one.columns, *one.rows]) for one in _grids(figures)]


def markdown(figures: dict[str, Any]) -> str:
    """Return the figures as a page of Markdown; every number comes from them."""
    machine = figures["machine"]
    where = f"{machine['cpu']}, {machine['cores']} cores, {machine['memory_gb']} GB, Python {machine['python']}"
    loads = f"Load of the last minute: {machine['load']:.1f} before, {figures['load_after']:.1f} after."
    lines = [
        "# How far one machine goes",
        "",
        "Written by `skyfolio bench scale`; do not edit. Measured on",
        f"{where}.",
    ]
    lines += [loads, "[scaling.md](../scaling.md) says what follows from it."]
    for one in _grids(figures):
        lines += ["", f"## {one.title}", "", *([one.said, ""] if one.said else []), grid([one.columns, *one.rows])]
    return "\n".join(lines) + "\n"


def _grids(figures: dict[str, Any]) -> list[Grid]:
    return [
        _strong(figures["sweep"]),
        _weak(figures["sweep"]),
        _engine(figures["sweep"]),
        _faults(figures),
        _service(figures["service"]),
        _streams(figures["service"]),
        _stored(figures["service"]),
        _solves(figures),
        _assumed(figures),
        _needed(figures),
    ]


def _strong(sweep: dict[str, Any]) -> Grid:
    said = (
        "`used`: the share of the cores' time that the cases would need as they run in the first row on Dask. What is "
        "lost: `slower` is the same cases taking longer, because cores share caches and memory and workers share "
        "cores; `engine` is scheduler and client; `others` are other programs of the machine; `idle` is nobody."
    )
    columns = [
        "cores",
        "workers",
        "seconds",
        "cases/s",
        "speed-up",
        "CPU ms a case",
        "used",
        "slower",
        "engine",
        "others",
    ]
    rows = [_pace("in this process", sweep["alone"]), *(_pace("plain pool", row) for row in sweep["pool"])]
    for row in sweep["strong"]:
        slower, engine, others, idle = (f"{share:.0%}" for share in row["lost"].values())
        shares = [f"{row['used']:.0%}", slower, engine, others, idle, row["limit"]]
        rows.append([*_pace("", row)[:4], f"{row['speedup']:.2f}", f"{row['cpu_ms_per_case']:.0f}", *shares])
    return Grid(f"Strong scaling: the same {sweep['cases']} cases", said, [*columns, "idle", "limit"], rows)


def _pace(how: str, row: dict[str, Any]) -> list[str]:
    workers = f"{row['workers']} {how}".strip()
    paces = [str(row["cores"]), workers, f"{row['seconds']:.1f}", f"{row['cases_per_s']:.1f}"]
    return [*paces, "", f"{row['cpu_ms_per_case']:.0f}", *[""] * 6]


def _weak(sweep: dict[str, Any]) -> Grid:
    rows = [
        [
            *(str(row[name]) for name in ("cores", "workers", "cases")),
            f"{row['seconds']:.1f}",
            f"{row['efficiency']:.0%}",
        ]
        for row in sweep["weak"]
    ]
    said = "Cases in proportion to the workers."
    return Grid("Weak scaling", said, ["cores", "workers", "cases", "seconds", "efficiency"], rows)


def _engine(sweep: dict[str, Any]) -> Grid:
    engine, memory = sweep["engine"], sweep["memory"]
    dask, pool, pickled = engine["dask"], engine["pool"], engine["pickled"]
    rows = [
        ["a batch without work in Dask, one worker", f"{dask['ms']:.2f} ms"],
        ["of it, processor of scheduler and client", f"{dask['client_cpu_ms']:.2f} ms"],
        ["of it, processor of the worker", f"{dask['worker_cpu_ms']:.2f} ms"],
        ["the same in a plain pool of processes", f"{pool['ms']:.2f} ms"],
        ["pickling and unpickling a batch and its part", f"{pickled['ms']:.3f} ms"],
        ["bytes of a batch, of its part", f"{pickled['batch_bytes']:,} / {pickled['part_bytes']:,}"],
        ["workers that batches of 1 s keep busy", f"{1e3 / dask['client_cpu_ms']:.0f}"],
    ]
    rows += [
        [f"copying memory, {row['processes']} at once, each", f"{row['gb_per_s_each']:.1f} GB/s"] for row in memory
    ]
    return Grid("What the engine costs", "", ["what", "figure"], rows)


def _faults(figures: dict[str, Any]) -> Grid:
    killed, stopped = figures["killed"], figures["stopped"]
    rows = [
        [f"workers killed, one every {killed['kill_every_s']:g} s", str(killed["killed"])],
        ["cases, in seconds", f"{killed['cases']} in {killed['seconds']:.0f}"],
        ["rows lost", str(killed["lost"])],
        ["rows doubled", str(killed["doubled"])],
        ["cases computed again", f"{killed['recomputed']:.1%}"],
        [
            "from Ctrl-C in mid-solve to the end of the command, p50 (max)",
            f"{stopped['p50_s']:.2f} ({stopped['max_s']:.2f}) s",
        ],
        ["parts lost by Ctrl-C", str(stopped["lost"])],
    ]
    return Grid("Killed and stopped", "Two workers.", ["what", "figure"], rows)


def _service(service: dict[str, Any]) -> Grid:
    said = (
        "Shares of one core. `link`: the bridge alone, vehicles on the ground; `service`: the whole process while it "
        "flies them, without its solver. Bytes and messages of one vehicle, both ways together, frames alone."
    )
    flying = {row["vehicles"]: row for row in service["flying"]}
    columns = ["vehicles", "link", "service", "service MB", "bytes/s each", "messages/s each", "heard"]
    rows = []
    for row in service["bridge"]:
        flown = flying.get(row["vehicles"])
        whole = [f"{flown['share_of_one_core']:.0%}", f"{flown['memory_mb']:.0f}"] if flown else ["", ""]
        traffic = [f"{row['bytes_per_s']:.0f}", f"{row['messages_per_s']:.0f}", str(row["heard"])]
        rows.append([str(row["vehicles"]), f"{row['share_of_one_core']:.1%}", *whole, *traffic])
    return Grid("Vehicles of one service", said, columns, rows)


def _streams(service: dict[str, Any]) -> Grid:
    first = service["streams"][0]
    said = (
        f"Each receives telemetry of {first['vehicles']} vehicles, up to 10 pictures a second, and all events. "
        "Pictures are left out for those who cannot keep up, events never. All share the cores with the vehicles."
    )
    columns = ["subscribers", "events", "lost", "delay p99, s", "pictures/s, least", "mean", "share of a core", "MB"]
    rows = [
        [
            str(row["subscribers"]),
            str(row["events"]),
            str(row["events_lost"]),
            "-" if row["event_delay_p99_s"] is None else f"{row['event_delay_p99_s']:.2f}",
            f"{row['pictures_per_s_least']:.1f}",
            f"{row['pictures_per_s_mean']:.1f}",
            f"{row['share_of_one_core']:.0%}",
            f"{row['memory_mb']:.0f}",
        ]
        for row in service["streams"]
    ]
    return Grid("Subscribers of one service", said, columns, rows)


def _stored(service: dict[str, Any]) -> Grid:
    rows = []
    for row in service["events"]:
        paces = f"{row['per_s']:,.0f} a second, {row['per_day'] / 1e6:,.0f} million a day"
        rows.append([f"events that {row['database']} stores", f"{paces}, {row['bytes_per_event']:.0f} bytes each"])
    for row in service["flights"]:
        told = f"{row['commits_per_s']:.1f} commits/s, {row['events_per_uav_hour']:,.0f} events and "
        rows.append(
            [f"a flight of {row['uavs']} UAVs", f"{told}{row['bytes_per_uav_hour'] / 1e6:.1f} MB per UAV and hour"]
        )
    return Grid("Events and what is stored", "Flights are flown in virtual time.", ["what", "figure"], rows)


def _solves(figures: dict[str, Any]) -> Grid:
    plans, area, robust = figures["service"]["plans"], figures["area"], figures["robustness"]
    size = f"{area['uavs']}x{area['users']}x{area['slots']}"
    errors = sum(plans["errors"].values())
    rows = [
        [
            f"small plans asked for at {plans['asked_per_s']} a second",
            f"{plans['served_per_s']:.0f} a second, p99 {plans['p99_ms']:.0f} ms, {errors} refused",
        ],
        [f"plan of one area, {size}", f"{area['plan_cpu_s']:.2f} core seconds, gap {area['gap']:.1%}"],
        ["replan of it after a loss", f"{area['replan_cpu_s']:.2f} core seconds"],
        ["peak memory of the process that does it", f"{area['peak_mb']:.0f} MB"],
        [f"robustness: {robust['draws']} draws, {robust['losses']} losses of 3x9x20", f"{robust['seconds']:.2f} s"],
    ]
    return Grid("Plans", "", ["what", "figure"], rows)


def _assumed(figures: dict[str, Any]) -> Grid:
    assumed, area = figures["many"]["assumed"], figures["area"]
    rows = [
        ["areas, each an operation", f"{assumed['areas']}"],
        ["UAVs of each; users and slots", f"{assumed['uavs']}; {area['users']} and {area['slots']}"],
        ["plans of an area, an hour (worst)", f"{assumed['plans_per_hour']:g} ({assumed['worst_plans_per_hour']:g})"],
        ["losses of a UAV, an hour", f"{assumed['losses_per_uav_hour']:g}"],
        ["UAVs lost in the worst hour", f"{assumed['worst_lost']:.0%}"],
        ["every single loss is planned ahead anew", f"every {assumed['contingencies_every_s']:g} s, and after a loss"],
        ["all areas planned anew at once within", f"{assumed['burst_s']:g} s"],
        ["subscribers of each area", f"{assumed['subscribers']}"],
        [
            "a core is busy with a service (a solving process)",
            f"{assumed['service_filled']:.0%} ({assumed['workers_filled']:.0%})",
        ],
        ["events and tracks are kept", f"{assumed['keep_days']:g} days"],
    ]
    said = "Areas do not interfere with each other, and other machines are as fast as this one."
    return Grid(f"{assumed['areas']} areas: what is assumed", said, ["what", "assumed"], rows)


def _needed(figures: dict[str, Any]) -> Grid:
    needed, assumed = figures["many"]["needed"], figures["many"]["assumed"]
    rows = [
        ["UAVs", f"{needed['uavs']:,}"],
        ["services, areas of each", f"{needed['services']}, {needed['areas_per_service']}"],
        ["share of a core of each service", f"{needed['service_share']:.0%}"],
        [
            "telemetry, MAVLink over UDP: all, each service",
            _pair(needed, "telemetry_mbit_s", "telemetry_mbit_s_each_service", "Mbit/s"),
        ],
        ["commits a second", f"{needed['commits_per_s']:,.0f}"],
        ["events a second, a day", f"{needed['events_per_s']:,.0f}, {needed['events_per_day'] / 1e6:,.1f} million"],
        ["of what one database stores", f"{needed['share_of_one_database']:.0%}"],
        [f"stored a day, in {assumed['keep_days']:g} days", _pair(needed, "stored_gb_per_day", "stored_gb", "GB")],
        ["Dask workers: normal hour", str(needed["dask_normal"])],
        ["Dask workers: worst hour", str(needed["dask_worst_hour"])],
        ["Dask workers: all areas at once", str(needed["dask_burst"])],
        ["Dask workers if every loss were planned ahead in every slot", str(needed["dask_every_slot"])],
        ["processes", f"{needed['processes']}"],
        ["cores", f"{needed['cores']}"],
        ["memory", f"{needed['memory_gb']:,.0f} GB"],
    ]
    return Grid(f"{assumed['areas']} areas: what is needed", "", ["what", "needed"], rows)


def _pair(needed: dict[str, Any], one: str, other: str, unit: str) -> str:
    return f"{needed[one]:,.1f}, {needed[other]:,.1f} {unit}"
