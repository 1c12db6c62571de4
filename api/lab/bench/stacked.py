"""What separation by altitude would gain and cost, beside separation over ground.

Gain: plans over hills with altitudes chosen, and plans for users who crowd in one place, once with `min_separation_m`
over ground and once without any separation. No rule that also lets UAVs fly above each other could gain more than the
difference. Cost: two simulated vehicles of which one hovers above the other; one returns or lands as its failsafe does.

    python -m skyfolio.api.lab.bench.stacked
"""

from __future__ import annotations

from math import dist
from typing import NamedTuple

import numpy as np

from skyfolio import sim
from skyfolio.api.lab.bench.cases import instance
from skyfolio.api.lab.bench.instances import Size
from skyfolio.api.lab.bench.terrain import over_terrain, with_altitudes
from skyfolio.planner import Plan, Scenario, Uav, User, plan
from skyfolio.planner.examples import ZURICH
from skyfolio.sim.autopilot import Autopilot
from skyfolio.sim.modes import Mode

SIZES: tuple[Size, ...] = ((3, 9, 20), (10, 100, 50))
LAYOUTS = 4
STARTS = 4
STEP_S = 0.05
CLIMBS_S, MOVES_S = 40.0, 90.0
LOW_M, HIGH_M = 20.0, 28.0
"""Above home: the two altitudes of the vehicles that hover above each other."""


class Gain(NamedTuple):
    """Utilities in kbit/s; closest_m: how near UAVs come to each other over ground where nothing keeps them apart."""

    name: str
    apart_kbps: float
    free_kbps: float
    closest_m: float


def crowd(seed: int) -> Scenario:
    """Return a scenario whose users all stand within 30 m, and whose UAVs start 20 m apart above them."""
    rng = np.random.default_rng(seed)
    places = 250.0 + rng.uniform(-15.0, 15.0, (9, 2))
    uavs = tuple(Uav(id=f"uav-{n}", start_m=(230.0 + 20.0 * n, 250.0)) for n in range(3))
    users = tuple(User(id=f"user-{n}", position_m=(float(e), float(s))) for n, (e, s) in enumerate(places))
    return Scenario(
        origin=ZURICH,
        area_m=((0.0, 0.0), (500.0, 500.0)),
        slots=20,
        slot_duration_s=5.0,
        altitude_m=40.0,
        altitude_max_m=80.0,
        min_separation_m=10.0,
        uavs=uavs,
        users=users,
    )


def gains() -> list[Gain]:
    """Return what no separation at all would gain in each scenario."""
    found = []
    for size in SIZES:
        for seed in range(1, LAYOUTS + 1):
            scenario = with_altitudes(over_terrain(instance(size, "sum", seed), seed))
            found.append(_gain(f"{'x'.join(map(str, size))} over hills, {seed}", scenario))
    return [*found, *(_gain(f"users in one place, {seed}", crowd(seed)) for seed in range(1, LAYOUTS + 1))]


def _gain(name: str, scenario: Scenario) -> Gain:
    apart = plan(scenario, n_starts=STARTS)
    free = plan(scenario.with_changes(min_separation_m=0.0), n_starts=STARTS)
    return Gain(name, apart.summary.utility_bps / 1e3, free.summary.utility_bps / 1e3, closest_m(free))


def closest_m(made: Plan) -> float:
    """Return the least distance over ground between UAVs of a plan when slots begin, metres."""
    paths_m = np.array([made.trajectories_m[uav] for uav in made.scenario.uav_ids])
    one, other = np.triu_indices(len(paths_m), 1)
    return float(np.linalg.norm(paths_m[one] - paths_m[other], axis=-1).min())


class Flown(NamedTuple):
    """The least distance in three dimensions, metres, that a vehicle keeps from the one above or below it."""

    what: str
    autopilot: str
    stacked_m: float
    beside_m: float


def costs() -> list[Flown]:
    """Return what failsafes do to vehicles above each other, and to those as far apart over ground."""
    moves = (("the lower one returns", LOW_M, HIGH_M, Mode.RTL), ("the upper one lands", HIGH_M, LOW_M, Mode.LAND))
    return [
        Flown(what, autopilot, nearest_m(autopilot, begins_m, mode, (0.0, 0.0, stays_m)), beside)
        for autopilot in sim.AUTOPILOTS
        for what, begins_m, stays_m, mode in moves
        for beside in [nearest_m(autopilot, begins_m, mode, (0.0, HIGH_M - LOW_M, begins_m))]
    ]


def nearest_m(autopilot: str, begins_m: float, mode: Mode, other_m: tuple[float, float, float]) -> float:
    """Return how near a vehicle comes to a place (east, north, up, metres) when its mode changes where it hovers.

    It hovers 60 m east of its home. The place is that of the other vehicle, which stays where it is.
    """
    spec = sim.VehicleSpec(1, 47.397742, 8.545594, autopilot=autopilot)
    vehicle = Autopilot(spec, protocol_clock=lambda: 0.0, on_event=lambda _kind, _detail: None)
    vehicle.arm(force=True)
    vehicle.set_mode(Mode.GUIDED)  # ArduCopter takes off in it; PX4 refuses it, and needs none
    vehicle.takeoff(begins_m)
    _let_pass(vehicle, CLIMBS_S)
    vehicle.home_m = (-60.0, 0.0)
    vehicle.set_mode(mode)
    nearest_m = dist(vehicle.body[:3], other_m)
    for _ in range(round(MOVES_S / STEP_S)):
        _let_pass(vehicle, STEP_S)
        nearest_m = min(nearest_m, dist(vehicle.body[:3], other_m))
    return nearest_m


def _let_pass(vehicle: Autopilot, seconds: float) -> None:
    for _ in range(round(seconds / STEP_S)):
        vehicle.step(vehicle.now_s + STEP_S, STEP_S)


def main() -> None:
    """Print both tables."""
    print("| plan | kbit/s with min_separation_m over ground | without any separation | closest then, m |")  # noqa: T201
    print("|---|---|---|---|")  # noqa: T201
    for gain in gains():
        print(f"| {gain.name} | {gain.apart_kbps:.2f} | {gain.free_kbps:.2f} | {gain.closest_m:.0f} |")  # noqa: T201
    print("\n| failsafe | autopilot | nearest if 8 m above each other, m | if 8 m apart over ground |")  # noqa: T201
    print("|---|---|---|---|")  # noqa: T201
    for flown in costs():
        print(f"| {flown.what} | {flown.autopilot} | {flown.stacked_m:.1f} | {flown.beside_m:.1f} |")  # noqa: T201


if __name__ == "__main__":
    main()
