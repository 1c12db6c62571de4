"""What tests of reliefs share: stations, pads, a pool, a crew that changes batteries, and looks at what was flown."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from contextlib import contextmanager

from skyfolio import sim
from skyfolio.api.flights.endless.relief_terms import ReliefTerms
from skyfolio.api.lab.virtual.ground import Ground
from skyfolio.api.lab.virtual.loop import VirtualLoop
from skyfolio.planner import EXAMPLES, Scenario, Uav, User
from skyfolio.planner.energy.parts import Battery, Rotors
from skyfolio.planner.scenario import Point
from skyfolio.sim import airframe
from tests.api.sky import NO_LIMIT, Sky

MINUTES = 8.0
MAH = sim.capacity_for_mah(MINUTES)
BATTERY = Battery(usable_wh=round(MAH * airframe.NOMINAL_V / 1000.0, 3), reserve_share=0.25)
ROTORS = Rotors(
    blade_w=airframe.BLADE_W,
    tip_mps=airframe.TIP_MPS,
    induced_w=airframe.INDUCED_W,
    induced_mps=airframe.INDUCED_MPS,
    parasite_w_per_mps3=airframe.PARASITE_W_PER_MPS3,
    climb_w_per_mps=airframe.MASS_KG * airframe.GRAVITY_MPS2,
)
"""Those of the vehicle that is simulated: what a fit of its telemetry gives. The defaults are of a vehicle that takes
15 % less."""
PAD_APART_M, SLOT_S, HORIZON, EVERY = 12.0, 5.0, 16, 4
TURNAROUND_S = 60.0


ONE_STATION: tuple[Point, ...] = ((300.0, 150.0),)
THREE_STATIONS: tuple[Point, ...] = ((40.0, 60.0), (360.0, 60.0), (200.0, 360.0))
PADS: tuple[Point, ...] = ((180.0, 150.0), (220.0, 150.0), (200.0, 190.0), (200.0, 150.0))
"""Of the first vehicles; those of the others are beside them."""


def _pads(vehicles: int) -> list[Point]:
    """Where vehicles stand, PAD_APART_M apart or more."""
    return [*PADS, *((164.0 + PAD_APART_M * 2 * n, 130.0) for n in range(vehicles))][:vehicles]


def whole(stations_m: tuple[Point, ...], vehicles: int, rotors: Rotors = ROTORS) -> Scenario:
    """A scenario of all vehicles on their pads, with three users around each station."""
    users = tuple(
        User(id=f"user-{number}-{k}", position_m=(east + 15.0 * k - 15.0, north + 10.0 * (k % 2)))
        for number, (east, north) in enumerate(stations_m, start=1)
        for k in range(3)
    )
    uavs = tuple(
        Uav(id=f"uav-{n}", start_m=pad_m, max_speed_mps=6.0, battery=BATTERY, rotors=rotors)
        for n, pad_m in enumerate(_pads(vehicles), start=1)
    )
    base = EXAMPLES["paper"]()
    return base.with_changes(
        area_m=((0.0, 0.0), (400.0, 400.0)), uavs=uavs, users=users, slots=HORIZON, altitude_m=20.0
    )


def of_stations(scenario: Scenario, stations: int) -> tuple[Scenario, ReliefTerms]:
    """The scenario of the vehicles that begin at stations, and the others as a pool."""
    first = scenario.with_changes(uavs=scenario.uavs[:stations])
    return first, ReliefTerms(pool=scenario.uavs[stations:], turnaround_s=TURNAROUND_S + 15.0)


@contextmanager
def pooled(
    scenario: Scenario, stations: int, *, seed: int = 1, **settings: object
) -> Iterator[tuple[Sky, ReliefTerms]]:
    """A sky in which all vehicles stand on their pads, registered, with a crew, and a plan for the first ones."""
    first, terms = of_stations(scenario, stations)
    crew = sim.GroundCrew(members=2, turnaround_s=TURNAROUND_S, packs=sim.Packs(count=4, charge_s=600.0))
    with asyncio.Runner(loop_factory=VirtualLoop) as runner:

        async def made() -> Ground:
            return Ground(
                scenario,
                specs=Ground.specs_of(scenario, battery_mah=MAH),
                seed=seed,
                crew=crew,
                rate_burst=NO_LIMIT,
                **settings,  # type: ignore[arg-type]
            )

        ground = runner.run(made())
        sky = Sky(runner, ground, scenario)
        try:
            runner.run(ground.__aenter__())
            sky.start()
            sky.plan = sky.client.plan(first)
            for number, uav in enumerate(scenario.uav_ids, start=1):
                sky.client.register(uav, number)
            sky.wait(lambda: all(one.link == "live" for one in sky.client.vehicles()), "all are heard")
            yield sky, terms
        finally:
            runner.run(ground.__aexit__(None, None, None))
