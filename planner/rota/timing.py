"""When each flight of an order begins and ends: a linear program, solved by HiGHS.

Given who relieves whom, everything that must hold is a difference of two times, so the best times in whole steps are a
corner of the program: with integers on the right its matrix, differences and one slack a row, is totally unimodular.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import linprog
from scipy.sparse import coo_array

from skyfolio.planner.arrays import Array
from skyfolio.planner.rota.orders import Flight, Order, Steps
from skyfolio.planner.rota.shifts import PoolVehicle

BEYOND = 0.2
"""What a dark step beyond the horizon counts, of one within."""
LATE = 5e-5
"""What it is worth to begin a flight a step later: fewer reliefs until the horizon. All of an order's flights together
are worth less than one dark step, so that no station is left alone for it."""


@dataclass(frozen=True)
class Timed:
    """An order with its times in steps: from when to when each flight is at its station, and when it is turned around.

    dark: how many steps of all stations have no vehicle until the horizon. reliefs: how many flights begin until then.
    margin: by how much new stays end before energy does. grounded: when those that are inbound now are turned around.
    """

    order: Order
    begins: tuple[int, ...]
    ends: tuple[int, ...]
    turned: tuple[int, ...]
    dark: int
    reliefs: int
    margin: int
    grounded: Mapping[str, int]

    @property
    def rank(self) -> tuple[int, int, int]:
        """Less is better: dark time, then reliefs, then the least time by which a stay ends before energy does."""
        return self.dark, self.reliefs, -self.margin


@dataclass
class _Program:
    """Rows of `sum of factor * variable <= most`; each variable has a cost and bounds."""

    costs: list[float] = field(default_factory=list)
    bounds: list[tuple[float, float | None]] = field(default_factory=list)
    entries: list[tuple[int, int, float]] = field(default_factory=list)
    most: list[float] = field(default_factory=list)

    def variable(self, cost: float = 0.0, low: float = 0.0, high: float | None = None) -> int:
        """Add a variable, and return its number."""
        self.costs.append(cost)
        self.bounds.append((low, high))
        return len(self.costs) - 1

    def at_most(self, terms: Sequence[tuple[int, float]], most: float) -> None:
        """Require that the sum of factor * variable is at most this."""
        self.most.append(most)
        self.entries.extend((len(self.most) - 1, variable, factor) for variable, factor in terms)

    def solved(self) -> Array | None:
        """Return the values of the variables at an optimal corner; None where nothing fits."""
        rows, columns, factors = zip(*self.entries, strict=True)
        matrix = coo_array((factors, (rows, columns)), shape=(len(self.most), len(self.costs))).tocsr()
        found = linprog(self.costs, A_ub=matrix, b_ub=self.most, bounds=self.bounds, method="highs-ds")
        return np.asarray(found.x) if found.success else None


@dataclass(frozen=True)
class _Variables:
    begins: list[int]
    ends: list[int]
    turned: list[int]
    margin: int | None
    grounded: dict[str, int] = field(default_factory=dict)


def timed(order: Order, pool: Sequence[PoolVehicle], stations: Sequence[str], steps: Steps) -> Timed | None:
    """Return the best times of an order: least dark, then late, then with margins; None where nothing fits."""
    first = _times(order, pool, stations, steps, 0, None)
    if first is None:
        return None
    later = frozenset(k for k, begin in enumerate(first.begins) if begin >= steps.horizon)
    margin = _most_margin(order, pool, stations, steps, first, later)
    best = _times(order, pool, stations, steps, margin, later) if margin > 0 else None
    if best is None or best.rank[:2] > first.rank[:2]:
        return first
    return best


def _most_margin(
    order: Order,
    pool: Sequence[PoolVehicle],
    stations: Sequence[str],
    steps: Steps,
    first: Timed,
    later: frozenset[int],
) -> int:
    """Return by how many steps all new stays can end before their energy does, at no more dark time and reliefs."""
    program, variables, dark = _program(order, pool, stations, steps, 0, later, with_margin=True)
    assert variables.margin is not None  # noqa: S101 - it was asked for
    spent = sum(
        program.costs[k] * value for k, value in zip(dark, _dark_of(first, order, stations, steps), strict=True)
    )
    program.at_most([(k, program.costs[k]) for k in dark], spent + 1e-6)
    program.costs = [0.0] * len(program.costs)
    program.costs[variables.margin] = -1.0
    found = program.solved()
    return 0 if found is None else int(np.floor(found[variables.margin] + 1e-6))


def _times(
    order: Order,
    pool: Sequence[PoolVehicle],
    stations: Sequence[str],
    steps: Steps,
    margin: int,
    later: frozenset[int] | None,
) -> Timed | None:
    program, variables, _ = _program(order, pool, stations, steps, margin, later, with_margin=False)
    found = program.solved()
    if found is None:
        return None
    begins, ends, turned = (
        tuple(round(float(found[k])) for k in row) for row in (variables.begins, variables.ends, variables.turned)
    )
    rows = {station: [k for k, f in enumerate(order.flights) if f.station == station] for station in stations}
    dark = sum(_dark_within([(begins[k], ends[k]) for k in row], steps.horizon) for row in rows.values())
    reliefs = sum(begin < steps.horizon for begin in begins)
    grounded = {vehicle: round(float(found[k])) for vehicle, k in variables.grounded.items()}
    return Timed(order, begins, ends, turned, dark, reliefs, margin, grounded)


def _dark_within(stays: Sequence[tuple[int, int]], horizon: int) -> int:
    at = dark = 0
    for begin, end in sorted(stays):
        dark += max(0, min(begin, horizon) - at)
        at = max(at, min(end, horizon))
    return dark + max(0, horizon - at)


def _dark_of(first: Timed, order: Order, stations: Sequence[str], steps: Steps) -> list[float]:
    """Return the values of the slacks, in the order in which `_program` makes them."""
    values = []
    for station in stations:
        row = [k for k, flight in enumerate(order.flights) if flight.station == station]
        for before, k in zip([None, *row], [*row, None], strict=True):
            if k is None:
                end = 0 if before is None else first.ends[before]
                values.append(float(max(0, steps.horizon - end)))
            elif before is None:
                values.append(float(first.begins[k]))
            else:
                values.append(float(max(0, first.begins[k] + steps.overlap - first.ends[before])))
    return values


def _program(
    order: Order,
    pool: Sequence[PoolVehicle],
    stations: Sequence[str],
    steps: Steps,
    margin: int,
    later: frozenset[int] | None,
    *,
    with_margin: bool,
) -> tuple[_Program, _Variables, list[int]]:
    """Return the program of an order, its variables, and the slacks that say how long stations are left alone.

    margin: what stays are shortened by. later: flights that begin beyond the horizon, if that is to stay so.
    """
    program = _Program()
    m = program.variable() if with_margin else None
    begins, ends, turned = [], [], []
    for k, flight in enumerate(order.flights):
        begins.append(_begin(program, flight, k, steps, later))
        ends.append(program.variable())
        turned.append(program.variable())
        counts = flight.begins is None and not (later and k in later)
        stay = flight.stay - (margin if counts and flight.stay > margin else 0)
        stay_terms = [(ends[k], 1.0), (begins[k], -1.0)]
        program.at_most([*stay_terms, (m, 1.0)] if m is not None and counts else stay_terms, stay)
        program.at_most([(begins[k], 1.0), (ends[k], -1.0)], 0.0 if flight.begins is not None else -1.0)
        program.at_most([(ends[k], 1.0), (turned[k], -1.0)], -flight.back)
    variables = _Variables(begins, ends, turned, m)
    grounded = _on_ground(program, order, pool, steps, variables)
    _rows_of_vehicles(program, order, pool, steps, variables, grounded)
    dark: list[int] = []
    for station in stations:
        dark += _row_of_station(program, order, station, steps, variables, later)
    return program, variables, dark


def _begin(program: _Program, flight: Flight, k: int, steps: Steps, later: frozenset[int] | None) -> int:
    if flight.begins is not None:
        return program.variable(low=flight.begins, high=flight.begins)
    low = max(steps.lead + flight.out, steps.horizon if later and k in later else 0)
    return program.variable(cost=-LATE, low=low)


def _on_ground(
    program: _Program, order: Order, pool: Sequence[PoolVehicle], steps: Steps, variables: _Variables
) -> dict[str, tuple[int, float]]:
    """Add what the crew can do; return by vehicle that is on its way down or turned around what it is ready after.

    That is a variable, and how much later it is ready.
    """
    known = {vehicle.id: vehicle for vehicle in pool}
    grounded: dict[str, tuple[int, float]] = {}
    turns: list[tuple[int, float]] = []
    now = 0  # so many are turned around now, which is a fact, and they come first
    for one in order.landings:
        if isinstance(one, int):
            turns.append((variables.turned[one], steps.turn))
            continue
        vehicle = known[one]
        if vehicle.state == "turnaround":
            ready = steps.up(vehicle.ready_s or 0.0)
            grounded[one] = program.variable(low=ready, high=ready), 0.0
            now += 1
        else:
            grounded[one] = program.variable(cost=LATE, low=steps.up(vehicle.lands_s or 0.0)), steps.turn
            variables.grounded[one] = grounded[one][0]
        turns.append(grounded[one])
    if steps.at_once is not None:
        begun = sorted(turns[:now], key=lambda turn: program.bounds[turn[0]][0])[-steps.at_once :]
        turns = [*begun, *turns[now:]]
        for (before, lasts), (after, _) in zip(turns, turns[steps.at_once :], strict=False):
            program.at_most([(before, 1.0), (after, -1.0)], -lasts)
    return grounded


def _rows_of_vehicles(
    program: _Program,
    order: Order,
    pool: Sequence[PoolVehicle],
    steps: Steps,
    variables: _Variables,
    grounded: dict[str, tuple[int, float]],
) -> None:
    """Have each vehicle fly one flight after the other, turned around in between."""
    for vehicle in pool:
        ready = grounded.get(vehicle.id)
        for k, flight in enumerate(order.flights):
            if flight.vehicle != vehicle.id:
                continue
            if ready is not None:
                program.at_most([(ready[0], 1.0), (variables.begins[k], -1.0)], -(ready[1] + flight.out))
            ready = variables.turned[k], steps.turn


def _row_of_station(
    program: _Program, order: Order, station: str, steps: Steps, variables: _Variables, later: frozenset[int] | None
) -> list[int]:
    """Have the flights to one station follow each other; return the slacks of its hand-overs, the last of its end.

    The next but one comes once a vehicle has left: never are three of them there.
    """
    slacks: list[int] = []
    before: int | None = None
    left: int | None = None
    for k, flight in enumerate(order.flights):
        if flight.station != station:
            continue
        slack = program.variable(cost=BEYOND if later and k in later else 1.0)
        slacks.append(slack)
        if before is None:
            program.at_most([(variables.begins[k], 1.0), (slack, -1.0)], 0.0)
        else:
            handed = [(variables.begins[k], 1.0), (variables.ends[before], -1.0)]
            program.at_most([(variables.begins[before], 1.0), (variables.begins[k], -1.0)], 0.0)
            program.at_most([*handed, (slack, -1.0)], -steps.overlap)
            program.at_most([(variable, -factor) for variable, factor in handed], steps.overlap)
        if left is not None and flight.begins is None:
            program.at_most([(variables.ends[left], 1.0), (variables.begins[k], -1.0)], 0.0)
        before, left = k, before
    slack = program.variable(cost=1.0)
    slacks.append(slack)
    end = [] if before is None else [(variables.ends[before], -1.0)]
    program.at_most([*end, (slack, -1.0)], -float(steps.horizon))
    return slacks
