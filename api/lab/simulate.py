"""`skyfolio simulate`: the software fleet as a process of its own."""

from __future__ import annotations

import asyncio
import json
import signal
import sys
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from rich.console import Console

from skyfolio.api.client import Client
from skyfolio.api.fleet.simulated_fleet import hills_of, specs_at_starts, weather_of
from skyfolio.api.lab.radio import RadioTruth
from skyfolio.api.lab.radio_client import RadioClient
from skyfolio.mavlink_bridge import DEFAULT_AUTOPILOT, east_north_to_geodetic
from skyfolio.planner import EXAMPLES, Plan, Scenario
from skyfolio.sim import (
    Event,
    FieldKnobs,
    Fleet,
    Impairments,
    ScaledClock,
    TlogWriter,
    TruthChannel,
    Weather,
    as_line,
    channel_from,
    grid_of,
    impairments_from,
    parse_fault,
    serve,
    value_of,
)

WATCH_S = 0.2
_QUIET = ("items",)
"""Details of events that are too long for a line."""


class SimulateError(Exception):
    """An option of `skyfolio simulate` is wrong."""


@dataclass(frozen=True, kw_only=True)
class SimulateConfig:
    """What to simulate, as the command line has it.

    faults: `KIND:VEHICLE[@SECONDS|@slot=N][,KNOB=VALUE...]`. up, down, weather: `FIELD=VALUE,...` of `sim.Impairments`
    and `sim.Weather`. plan: gives the starts, the slots (slot 0 begins when every vehicle flies its mission), the
    distance from the schedule at each, and each slot's true rates, drawn from radio_seed. booted_s_ago: how long the
    vehicles have been on; switched on with the fleet, an ArduCopter cannot be armed for 40 s. radio_url: the service
    whose allocations the base stations serve, and to which they report; radio_channel: `FIELD=VALUE,...` of
    `sim.TruthChannel`, by how much the true channel differs; radio_key: an API key. field_knobs: crew, packs, fronts.
    """

    vehicles: int = 3
    speedup: float = 1.0
    autopilot: str = DEFAULT_AUTOPILOT.value
    endpoint: str = "udpout://127.0.0.1:14540"
    scenario: Scenario | None = None
    plan: Plan | None = None
    duration_s: float | None = None
    seed: int = 0
    radio_seed: int = 1
    faults: tuple[str, ...] = ()
    up: str = ""
    down: str = ""
    weather: str = ""
    log: Path | None = None
    tlog: Path | None = None
    signing_key: str = ""
    radio_url: str = ""
    radio_channel: str = ""
    radio_key: str | None = None
    booted_s_ago: float = 0.0
    field_knobs: FieldKnobs = field(default_factory=FieldKnobs)
    as_json: bool = False
    console: Console = field(default_factory=Console)


def fleet_of(config: SimulateConfig) -> Fleet:
    """Return the fleet, with its faults scheduled and its links impaired. Raises SimulateError naming the option."""
    scenario = config.plan.scenario if config.plan else config.scenario
    origin, knobs = EXAMPLES["paper"]().origin, config.field_knobs
    try:
        if scenario is not None:
            specs = specs_at_starts(scenario, config.autopilot, config.booted_s_ago, knobs.battery_mah)
        else:
            place = (origin.lat_deg, origin.lon_deg)
            grid = grid_of(config.vehicles, *place, autopilot=config.autopilot, booted_s_ago=config.booted_s_ago)
            specs = [replace(spec, battery_mah=knobs.battery_mah) for spec in grid]
        fleet = Fleet(
            specs,
            clock=ScaledClock(config.speedup),
            endpoint=config.endpoint,
            seed=config.seed,
            weather=_weather(config, scenario),
            signing_key=bytes.fromhex(config.signing_key) if config.signing_key else None,
            hills=None if scenario is None else hills_of(scenario),
            crew=knobs.crew,
        )
        fleet.impair(up=_impairments("--up", config.up), down=_impairments("--down", config.down))
        for text in config.faults:
            fault, at_s, at_slot = parse_fault(text)
            fleet.inject(fault, at_s=0.0 if at_s is None and at_slot is None else at_s, at_slot=at_slot)
    except (ValueError, TypeError) as error:
        raise SimulateError(str(error)) from error
    return fleet


def _weather(config: SimulateConfig, scenario: Scenario | None) -> Weather | None:
    """Return the weather that is asked for; without any, the wind of the scenario."""
    fronts = config.field_knobs.fronts
    if config.weather or scenario is None:
        return Weather(**_knobs("--weather", config.weather), fronts=fronts)
    return weather_of(scenario, fronts)


async def run_fleet(config: SimulateConfig) -> None:
    """Fly until SIGINT or SIGTERM (or for `duration_s` fleet seconds), printing what truly happens, line by line."""
    fleet = fleet_of(config)
    until = asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, until.set)
    if not config.as_json:
        words = f"{len(fleet.vehicles)} {config.autopilot} vehicles send to {config.endpoint}"
        config.console.print(f"{words} at {config.speedup:g} times real time; Ctrl-C ends them")
    channel = _channel(config.radio_channel)
    with ExitStack() as files:
        _record(fleet, config, files)
        beside = [asyncio.create_task(_watch(fleet, config))]
        if config.radio_url:
            client = files.enter_context(Client(config.radio_url, key=config.radio_key))
            radio = RadioClient(fleet, client, channel, config.speedup)
            beside.append(asyncio.create_task(radio.run(), name="base-stations"))
        try:
            await serve(fleet, until=until, for_s=config.duration_s)
        finally:
            for task in beside:
                task.cancel()
            fleet.truth.sink = fleet.truth.tlog = None


def _record(fleet: Fleet, config: SimulateConfig, files: ExitStack) -> None:
    if config.log is not None:
        config.log.parent.mkdir(parents=True, exist_ok=True)
        log = files.enter_context(config.log.open("w", encoding="utf-8"))
        fleet.truth.sink = lambda row: print(as_line(row), file=log)
    if config.tlog is not None:
        fleet.truth.tlog = files.enter_context(TlogWriter(config.tlog))


async def _watch(fleet: Fleet, config: SimulateConfig) -> None:
    printed = 0
    plan = config.plan
    uavs = dict(enumerate(plan.scenario.uav_ids, start=1)) if plan else {}
    radio = RadioTruth(plan, uavs, seed=config.radio_seed) if plan else None
    while True:
        for event in fleet.truth.events[printed:]:
            printed += 1
            _print_event(event, config)
        if plan is not None and fleet.slots is None:
            begin_slots(fleet, plan)
        for row in radio.rows(fleet) if radio else ():
            fleet.truth.note(row)
            _print_rates(row, config)
        await asyncio.sleep(WATCH_S / max(config.speedup, 1.0))


def begin_slots(fleet: Fleet, plan: Plan) -> None:
    """Begin slot 0 when the last living vehicle has entered its mission; before that, do nothing."""
    entered = {
        event.system_id: event.t_s for event in fleet.truth.happened("mode") if event.detail["mode"] == "MISSION"
    }
    living = {system_id for system_id, vehicle in fleet.vehicles.items() if vehicle.alive}
    if not living or not living <= set(entered):
        return
    origin = plan.scenario.origin
    points = {
        system_id: [east_north_to_geodetic(origin, *point) for point in plan.trajectories_m[uav]]
        for system_id, uav in enumerate(plan.scenario.uav_ids, start=1)
    }
    start_s = max(entered[system_id] for system_id in living)
    fleet.start_slots(plan.scenario.slot_duration_s, at_s=start_s, points=points)


def _print_event(event: Event, config: SimulateConfig) -> None:
    detail = {name: value for name, value in event.detail.items() if name not in _QUIET}
    if config.as_json:
        _print_json({"t_s": round(event.t_s, 3), "system_id": event.system_id, "kind": event.kind, **detail})
    else:
        words = " ".join(f"{name}={value}" for name, value in detail.items())
        config.console.print(f"{event.t_s:9.2f} s  vehicle {event.system_id}  {event.kind} {words}", highlight=False)


def _print_rates(row: dict[str, Any], config: SimulateConfig) -> None:
    if config.as_json:
        _print_json(row)
        return
    total = sum(rate or 0.0 for rate in row["user_rates_bps"].values()) / 1000.0
    config.console.print(f"{row['t_s']:9.2f} s  slot {row['slot']}  users got {total:.1f} kbit/s", highlight=False)


def _print_json(row: dict[str, Any]) -> None:
    sys.stdout.write(json.dumps(row) + "\n")
    sys.stdout.flush()


def _channel(text: str) -> TruthChannel:
    try:
        return channel_from(text)
    except ValueError as error:
        raise SimulateError(f"--radio-channel: {error}") from error


def _impairments(option: str, text: str) -> Impairments | None:
    return impairments_from(_knobs(option, text)) if text else None


def _knobs(option: str, text: str) -> dict[str, Any]:
    knobs = {}
    for part in text.split(",") if text else []:
        name, equals, value = part.partition("=")
        if not equals:
            raise ValueError(f"{option}: {part!r} must look like FIELD=VALUE")
        knobs[name] = value_of(value)
    return knobs
