"""Energy as planned against energy as flown: single flights in wind, in virtual time, of both autopilots.

The planner knows nothing of the simulated airframe. Each autopilot first makes a flight of its own in changing wind,
during which its SYS_STATUS and GLOBAL_POSITION_INT are kept as a service keeps them; rotors are fitted to those. Then
every flight of the benchmark has a plan of its own in a wind of its own, made with these rotors, and what the plan
expects from slot 0 on is compared with what the simulated battery has lost.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from math import cos, hypot, pi, sin
from typing import TYPE_CHECKING, Any

import numpy as np

from skyfolio import sim
from skyfolio.api.lab.bench.measure import quantile
from skyfolio.api.lab.bench.tracks import by_hand
from skyfolio.api.lab.virtual_flight import VirtualFlight
from skyfolio.api.lab.virtual_wire import fields_of
from skyfolio.mavlink_bridge import Autopilot
from skyfolio.mavlink_bridge.power_log import PowerLog, power_w_of
from skyfolio.planner import EXAMPLES, MaxIterations, Plan, Scenario, Uav, plan
from skyfolio.planner.energy.fit import Fit, fit_rotors
from skyfolio.planner.energy.outlook import charge_needed
from skyfolio.planner.geometry import Point
from skyfolio.planner.scenario import Battery, Rotors, Wind

if TYPE_CHECKING:
    from rich.table import Table

AGILE = {"WPNAV_JERK": 5.0}
"""As for the schedules of the bridge: with its default an ArduCopter starts too slowly for slots of 25 m in 5 s."""
MAX_AIRSPEED_MPS = 14.0
GUST_SPREADS = 3.0
"""The plan's bound of gusts, in spreads of one axis."""
USABLE_WH = 74.0
REPORT_S = 1.0
SYS_STATUS, GLOBAL_POSITION_INT = 1, 33
TARGET_ERROR = 0.05
CALIBRATIONS = ((0.0, 0.0), (3.0, 0.0), (6.0, 1.0), (9.0, 1.0))
"""Wind and spread of gusts, m/s, of the flights to which rotors are fitted."""


@dataclass(frozen=True, kw_only=True)
class Air:
    """The wind of one flight: m/s, and where it blows to, radians from east; spread of gusts on each axis."""

    wind_mps: float
    towards_rad: float
    gust_mps: float

    @property
    def blows_mps(self) -> Point:
        """East and north."""
        return self.wind_mps * cos(self.towards_rad), self.wind_mps * sin(self.towards_rad)

    def weather(self) -> sim.Weather:
        """Return it for the simulator."""
        east, north = self.blows_mps
        return sim.Weather(wind_east_mps=east, wind_north_mps=north, gust_mps=self.gust_mps)

    def wind(self) -> Wind:
        """Return it for the planner."""
        east, north = self.blows_mps
        return Wind(east_mps=east, north_mps=north, gust_mps=GUST_SPREADS * self.gust_mps)


def energy_figures(flights: int, told: Callable[[str], None] = lambda _text: None) -> dict[str, Any]:
    """Return the errors of `flights` flights, half of them of each autopilot, and the rotors that were fitted."""
    rows: list[dict[str, Any]] = []
    fits: dict[str, Any] = {}
    for number, autopilot in enumerate((Autopilot.PX4, Autopilot.ARDUPILOT)):
        told(f"{autopilot.value}: fitting its rotors")
        fit = fitted(autopilot)
        fits[autopilot.value] = {**fit.rotors.model_dump(), "rms_w": round(fit.rms_w, 2), "samples": fit.samples}
        share = flights // 2 + (flights % 2 if number == 0 else 0)
        for seed in range(share):
            rows.append(flown(autopilot, fit.rotors, seed))
            if seed % 10 == 9:
                told(f"{autopilot.value}: {seed + 1} of {share} flights")
    return {
        "flights": len(rows),
        "target_error": TARGET_ERROR,
        **{name: _summary([row for row in rows if row["autopilot"] in of]) for name, of in _GROUPS.items()},
        "rotors": fits,
        "rows": rows,
    }


_GROUPS = {"all": ("px4", "ardupilot"), "px4": ("px4",), "ardupilot": ("ardupilot",)}


def _summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    if not rows:
        return {"flights": 0}
    errors = [abs(row["error"]) for row in rows]
    return {
        "flights": len(rows),
        "error_p50": round(quantile(errors, 0.5), 4),
        "error_p95": round(quantile(errors, 0.95), 4),
        "error_max": round(max(errors), 4),
        "bias": round(float(np.mean([row["error"] for row in rows])), 4),
        "beyond_proven": sum(row["flown_wh"] > row["proven_wh"] for row in rows),
        "most_beyond": round(max(0.0, *(row["flown_wh"] / row["proven_wh"] - 1.0 for row in rows)), 4),
    }


def fitted(autopilot: Autopilot) -> Fit:
    """Return the rotors that explain what a vehicle of this autopilot reports in flights through several winds."""
    samples: list[tuple[float, float, float]] = []
    for seed, (wind_mps, gust_mps) in enumerate(CALIBRATIONS):
        air = Air(wind_mps=wind_mps, towards_rad=0.7 * seed, gust_mps=gust_mps)
        flight = VirtualFlight(_tour(), "uav-1", autopilot, _parameters(autopilot), weather=air.weather(), seed=seed)
        east, north = air.blows_mps
        for one in _reports(flight):
            airspeed = hypot(one.east_mps - east, one.north_mps - north)
            samples.append((airspeed, one.up_mps, one.power_w))
    airspeed, climb, power = np.array(samples).T
    return fit_rotors(airspeed, climb, power)


def _reports(flight: VirtualFlight) -> Iterator[Any]:
    """Fly, and return what a service would keep of the vehicle's reports of power and velocity."""
    log, due_s = PowerLog(), [0.0]

    def keep() -> None:
        now_s = flight.clock.now()
        if now_s < due_s[0]:
            return
        due_s[0] = now_s + REPORT_S
        built = (flight.vehicle.autopilot.telemetry.build(number) for number in (SYS_STATUS, GLOBAL_POSITION_INT))
        status, position = (fields_of(message) for message in built)
        log.add(power_w_of(status), now_s, armed=True)
        log.sample(position, now_s, now_s)

    flight.after_step = keep
    flight.fly("keeper")
    return iter(log.samples)


def _tour() -> Plan:
    """Return a plan of hovers and of legs of many speeds in all directions."""
    path: list[Point] = [(0.0, 0.0)]
    for leg in range(24):
        length, angle = 0.0 if leg % 6 == 5 else 5.0 + 45.0 * (leg % 5) / 4.0, 2.1 * leg
        east, north = path[-1]
        path.append((east + length * cos(angle), north + length * sin(angle)))
    scenario = EXAMPLES["paper"]().with_changes(
        slots=len(path),
        area_m=((-5000.0, -5000.0), (5000.0, 5000.0)),
        uavs=(Uav(id="uav-1", start_m=path[0], max_speed_mps=10.0),),
    )
    return by_hand(scenario, {"uav-1": path})


def flown(autopilot: Autopilot, rotors: Rotors, seed: int) -> dict[str, Any]:
    """Plan and fly one UAV in a wind of its own; return what was expected, proven and used, Wh."""
    chance = random.Random(f"energy/{autopilot.value}/{seed}")  # noqa: S311
    air = Air(
        wind_mps=chance.uniform(1.0, 8.0), towards_rad=chance.uniform(0.0, 2.0 * pi), gust_mps=chance.uniform(0.0, 1.2)
    )
    made = plan(_scenario(chance, rotors, air), n_starts=2, stop=MaxIterations(4))
    flight = VirtualFlight(made, "uav-1", autopilot, _parameters(autopilot), weather=air.weather(), seed=seed)
    battery, capacity_wh = flight.vehicle.autopilot.battery, _capacity_wh(flight)
    before = battery.share
    began_s = flight.clock.now()
    flight.fly("keeper")
    lasted_s = flight.clock.now() - began_s
    used_wh = (before - battery.share) * capacity_wh
    expected_wh, proven_wh = _planned_wh(made, lasted_s)
    return {
        "autopilot": autopilot.value,
        "seed": seed,
        "wind_mps": round(air.wind_mps, 2),
        "gust_mps": round(air.gust_mps, 2),
        "seconds": round(lasted_s, 1),
        "expected_wh": round(expected_wh, 4),
        "proven_wh": round(proven_wh, 4),
        "flown_wh": round(used_wh, 4),
        "error": round(expected_wh / used_wh - 1.0, 5),
        "charge_needed": round(charge_needed(made, "uav-1") or 0.0, 3),
    }


def _planned_wh(made: Plan, lasted_s: float) -> tuple[float, float]:
    """Return what the plan expects and proves for the flight from slot 0 to the beginning of its last slot, Wh.

    A flight may begin a little before slot 0, with a head start: it hovers for so much less at the end.
    """
    air, slot_s, n_slots = made.scenario.air, made.scenario.slot_duration_s, made.scenario.slots
    assert air is not None  # noqa: S101 - the scenario has wind
    moves = np.diff(np.array(made.trajectories_m["uav-1"]), axis=0)[None]
    rest_s = lasted_s - (n_slots - 1) * slot_s
    at_rest = np.zeros((1, 1, 2))
    expected, proven = (
        float(air.spent_wh(moves, proven=is_proven).sum())
        + float(air.spent_wh(at_rest, proven=is_proven)[0, 0]) * rest_s / slot_s
        for is_proven in (False, True)
    )
    return expected, proven


def _scenario(chance: random.Random, rotors: Rotors, air: Air) -> Scenario:
    """Return a scenario of one UAV and a few users, some far, in this wind."""
    paper = EXAMPLES["paper"]()
    start = chance.uniform(100.0, 400.0), chance.uniform(100.0, 400.0)
    uav = Uav(
        id="uav-1",
        start_m=start,
        max_speed_mps=chance.uniform(3.0, 6.0),
        max_airspeed_mps=MAX_AIRSPEED_MPS,
        battery=Battery(usable_wh=USABLE_WH),
        rotors=rotors,
    )
    users = tuple(
        user.model_copy(update={"position_m": (chance.uniform(0.0, 500.0), chance.uniform(0.0, 500.0))})
        for user in paper.users
    )
    return paper.with_changes(uavs=(uav,), users=users, wind=air.wind(), slots=chance.randrange(15, 26))


def _parameters(autopilot: Autopilot) -> dict[str, float]:
    return dict(AGILE) if autopilot is Autopilot.ARDUPILOT else {}


def _capacity_wh(flight: VirtualFlight) -> float:
    """Return what the simulated battery holds: the truth, which only the measure reads."""
    return float(flight.vehicle.autopilot.parameters.tuning.battery_capacity_mah) / 1000.0 * sim.airframe.NOMINAL_V


def table(figures: dict[str, Any]) -> Table:
    """Return the figures as a table."""
    from rich.table import Table  # noqa: PLC0415 - only where it is printed

    made = Table("vehicles", "flights", "error p50", "error p95", "worst", "bias", "beyond proven", "at most by")
    for row in _rows(figures):
        made.add_row(*row)
    return made


def _rows(figures: dict[str, Any]) -> Iterator[list[str]]:
    for name in _GROUPS:
        group = figures[name]
        if group["flights"]:
            shares = (f"{group[key]:.1%}" for key in ("error_p50", "error_p95", "error_max", "bias"))
            yield [name, str(group["flights"]), *shares, str(group["beyond_proven"]), f"{group['most_beyond']:.1%}"]


def markdown(figures: dict[str, Any]) -> str:
    """Return the page of these figures."""
    rows = "\n".join(f"| {' | '.join(row)} |" for row in _rows(figures))
    constants = ("blade_w", "tip_mps", "induced_w", "induced_mps", "parasite_w_per_mps3", "climb_w_per_mps", "rms_w")
    fits = "\n".join(
        f"| {name} | {' | '.join(f'{fit[key]:.4g}' for key in constants)} | {fit['samples']} |"
        for name, fit in figures["rotors"].items()
    )
    return f"""# Energy as planned and as flown

`skyfolio bench energy` flies {figures["flights"]} plans on the simulator in virtual time, each in a wind of its own
(1 to 8 m/s from any direction, gusts with a spread of up to 1.2 m/s on each axis), guided by mission and schedule
keeper. What a plan expects from slot 0 to the beginning of its last slot is compared with what the simulated battery
has lost by then. The planner does not know the simulated airframe: its rotors are fitted to what the vehicle reported
in four other flights. Errors are relative to what was used; `beyond proven` counts flights that used more than the plan
had proven to suffice: without gusts the proof has nothing to spare for turns and catching up, which are left to the
reserve. The figures are the same on any machine.

| vehicles | flights | error p50 | error p95 | worst | bias | beyond proven | at most by |
|---|---|---|---|---|---|---|---|
{rows}

The target is an error of at most {figures["target_error"]:.0%} at the 95th percentile.

The rotors that were fitted (see [wind and energy](../energy.md)); `rms` is what single reports differ by, W, gusts
included:

| autopilot | blade_w | tip_mps | induced_w | induced_mps | parasite_w_per_mps3 | climb_w_per_mps | rms | samples |
|---|---|---|---|---|---|---|---|---|
{fits}
"""
