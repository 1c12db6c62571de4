"""Rotas: stations stay manned by as few vehicles as can be, whatever the pool is doing now, and checked by others."""

from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skyfolio.planner import EXAMPLES, Scenario, Uav
from skyfolio.planner.energy.account import account_of
from skyfolio.planner.rota.bound import fleet_bound, most_manned_s
from skyfolio.planner.rota.check import rota_faults
from skyfolio.planner.rota.shifts import PoolVehicle, Rota, Sortie, Turnaround
from skyfolio.planner.rota.solver import rota_of
from skyfolio.planner.rota.stays import sortie_of, stay_left_s
from skyfolio.planner.scenario import Battery, Rotors, Wind

STATIONS = ("north", "east", "south")
CREW = Turnaround(seconds=180.0, at_once=2, overlap_s=15.0, lead_s=0.0)
SORTIE = Sortie(out_s=80.0, stay_s=675.0, back_s=110.0)


def pool_of(n: int, stations: Sequence[str] = STATIONS, sortie: Sortie = SORTIE) -> list[PoolVehicle]:
    return [PoolVehicle(id=f"uav-{k}", sorties=dict.fromkeys(stations, sortie)) for k in range(n)]


def checked(pool: Sequence[PoolVehicle], stations: Sequence[str], turnaround: Turnaround, **options: Any) -> Rota:
    rota = rota_of(pool, stations, turnaround, **options)
    assert rota_faults(rota, pool, stations, turnaround) == []
    return rota


def always_manned(rota: Rota, from_s: float) -> bool:
    return all(one.until_s <= from_s for one in rota.dark)


def test_three_stations_are_manned_for_a_day_by_the_least_fleet_there_can_be() -> None:
    """Without one of them there is no rota, so the bound is tight here."""
    bound = fleet_bound(pool_of(1), STATIONS, CREW)
    assert bound.least_fleet == 5
    assert bound.least_at("north") == 2
    rota = checked(pool_of(5), STATIONS, CREW, horizon_s=24 * 3600.0)
    assert always_manned(rota, 80.0)
    assert rota.optimal
    assert rota.least_fleet == 5
    short = checked(pool_of(4), STATIONS, CREW, horizon_s=8 * 3600.0)
    assert not always_manned(short, 80.0)
    assert fleet_bound(pool_of(4), STATIONS, CREW).sustained_share < 1.0


def test_the_scenario_of_a_working_day_in_wind_needs_no_more_than_one_spare() -> None:
    """18-minute packs, wind of 5 m/s that varies by 2 m/s either way, batteries swapped in three minutes."""
    scenario = EXAMPLES["minimal"]().with_changes(
        area_m=((0.0, 0.0), (500.0, 500.0)),
        altitude_m=60.0,
        wind=Wind(east_mps=3.0, north_mps=-4.0, gust_mps=2.0),
        slot_duration_s=5.0,
        uavs=(Uav(id="any", start_m=(20.0, 20.0), max_speed_mps=8.0, max_airspeed_mps=15.0),),
    )
    usable_wh = 18.0 / 60.0 * hover_w(scenario)
    places = {"north": (250.0, 400.0), "east": (400.0, 200.0), "south": (150.0, 100.0)}
    pads = [(20.0 + 15.0 * k, 20.0) for k in range(9)]
    vehicles = [
        Uav(id=f"uav-{k}", start_m=pad, max_speed_mps=8.0, max_airspeed_mps=15.0, battery=Battery(usable_wh=usable_wh))
        for k, pad in enumerate(pads)
    ]
    pool = []
    for uav in vehicles:
        sorties = {name: sortie_of(scenario, uav, place) for name, place in places.items()}
        pool.append(PoolVehicle(id=uav.id, sorties={name: one for name, one in sorties.items() if one is not None}))
    least = fleet_bound(pool, STATIONS, CREW).least_fleet
    assert least is not None
    assert 5 <= least <= 7
    first_s = max(one.out_s for vehicle in pool for one in vehicle.sorties.values())
    rota = checked(pool[: least + 1], STATIONS, CREW, horizon_s=8 * 3600.0)
    assert always_manned(rota, first_s + 5.0)


def hover_w(scenario: Scenario) -> float:
    air = scenario.air_for([scenario.uavs[0].model_copy(update={"battery": Battery(usable_wh=100.0)})])
    assert air is not None
    return float(air.hover_wh()[0]) * 3600.0 / scenario.slot_duration_s


class Sky:
    """Flies rotas: every few minutes a new one for what the pool is doing then, the old one until then."""

    def __init__(self, pool: list[PoolVehicle], stations: Sequence[str], turnaround: Turnaround) -> None:
        self.pool, self.stations, self.turnaround = pool, stations, turnaround
        self.manned: dict[str, list[tuple[float, float]]] = {station: [] for station in stations}
        self.now_s = 0.0

    def fly(self, seconds: float, horizon_s: float) -> Rota:
        """Plan, check, and fly the beginning of the rota."""
        rota = checked(self.pool, self.stations, self.turnaround, horizon_s=horizon_s)
        for shift in rota.shifts:
            begin, end = max(shift.from_s, 0.0), min(shift.until_s, seconds)
            if begin < end:
                self.manned[shift.station].append((self.now_s + begin, self.now_s + end))
        self.pool = [self._later(vehicle, rota, seconds) for vehicle in self.pool]
        self.now_s += seconds
        return rota

    def _later(self, vehicle: PoolVehicle, rota: Rota, seconds: float) -> PoolVehicle:
        left = [one for one in rota.shifts if one.vehicle == vehicle.id and one.leaves_pad_s < seconds]
        if not left:
            return self._grounded(vehicle, rota, seconds)
        last = max(left, key=lambda one: one.from_s)
        stay_s = vehicle.sorties[last.station].stay_s
        until_s = vehicle.until_s if last.under_way else last.from_s + stay_s
        told: dict[str, Any] = {"id": vehicle.id, "sorties": vehicle.sorties}
        if last.until_s > seconds:
            state = "outbound" if last.from_s > seconds else "on_station"
            told |= {"station": last.station, "from_s": last.from_s - seconds, "until_s": (until_s or 0.0) - seconds}
        elif last.lands_s > seconds:
            state, told["lands_s"] = "inbound", last.lands_s - seconds
        elif last.turned_s > seconds:
            state, told["lands_s"] = "inbound", 0.0
        else:
            state, told["ready_s"] = "turnaround", max(0.0, last.ready_s - seconds)
        return PoolVehicle(state=state, **told)

    @staticmethod
    def _grounded(vehicle: PoolVehicle, rota: Rota, seconds: float) -> PoolVehicle:
        ready = [one.ready_s for one in rota.grounded if one.vehicle == vehicle.id]
        if vehicle.state == "ready":
            return vehicle
        ready_s = ready[0] if ready else (vehicle.ready_s or 0.0)
        if ready and ready_s - CREW.seconds > seconds:
            return vehicle.model_copy(update={"lands_s": max(0.0, (vehicle.lands_s or 0.0) - seconds)})
        if ready_s <= seconds:
            return PoolVehicle(id=vehicle.id, sorties=vehicle.sorties)
        return PoolVehicle(id=vehicle.id, sorties=vehicle.sorties, state="turnaround", ready_s=ready_s - seconds)

    def dark_s(self, from_s: float) -> float:
        """Return how many seconds of all stations nobody was there since `from_s`."""
        dark = 0.0
        for rows in self.manned.values():
            at = from_s
            for begin, end in sorted(rows):
                dark += max(0.0, begin - at)
                at = max(at, end)
            dark += max(0.0, self.now_s - at)
        return dark


@pytest.mark.parametrize("spare", [0, 1])
def test_solved_again_every_few_minutes_no_station_is_ever_left_alone(spare: int) -> None:
    sky = Sky(pool_of(5 + spare), STATIONS, CREW)
    for _ in range(48):
        sky.fly(300.0, horizon_s=3600.0)
    assert sky.now_s == 4 * 3600.0
    assert sky.dark_s(from_s=80.0) == pytest.approx(0.0, abs=1e-6)


def test_after_a_loss_a_spare_goes_up_at_once_and_the_others_go_on() -> None:
    sky = Sky(pool_of(7), STATIONS, CREW)
    for _ in range(9):
        sky.fly(300.0, horizon_s=3600.0)
    lost = next(vehicle for vehicle in sky.pool if vehicle.state == "on_station")
    sky.pool.remove(lost)
    rota = sky.fly(300.0, horizon_s=3600.0)
    [hole] = [one for one in rota.dark if one.from_s == 0.0]
    assert hole.station == lost.station
    ready_s = min(vehicle.ready_s or 0.0 for vehicle in sky.pool if vehicle.state in {"ready", "turnaround"})
    assert hole.until_s <= max(ready_s, 300.0)
    before_s = sky.now_s
    for _ in range(24):
        sky.fly(300.0, horizon_s=3600.0)
    assert sky.dark_s(from_s=before_s) == pytest.approx(0.0, abs=1e-6)


def test_what_is_under_way_keeps_its_beginning_and_a_late_arrival_is_reckoned_with() -> None:
    late = PoolVehicle(
        id="late", sorties={"north": SORTIE}, state="outbound", station="north", from_s=203.0, until_s=700.0
    )
    there = PoolVehicle(
        id="there", sorties={"north": SORTIE}, state="on_station", station="north", from_s=-400.0, until_s=275.0
    )
    rota = checked([late, there, *pool_of(2, ("north",))], ("north",), CREW, horizon_s=1800.0)
    first, second = rota.of_station("north")[:2]
    assert (first.vehicle, first.under_way, first.until_s) == ("there", True, 220.0)
    assert (second.vehicle, second.from_s) == ("late", 203.0)
    assert rota.dark == ()
    assert rota.reliefs()[0] == (first, second)


def test_the_crew_turns_no_more_around_at_once_than_it_can() -> None:
    alone = CREW.model_copy(update={"at_once": 1, "seconds": 200.0})
    assert fleet_bound(pool_of(5), STATIONS, alone).least_crew == 1
    checked(pool_of(6), STATIONS, alone, horizon_s=2 * 3600.0)
    slow = CREW.model_copy(update={"at_once": 1, "seconds": 400.0})
    bound = fleet_bound(pool_of(9), STATIONS, slow)
    assert (bound.least_fleet, bound.least_crew) == (None, 2)
    assert bound.sustained_share < 1.0
    assert not always_manned(checked(pool_of(9), STATIONS, slow, horizon_s=4 * 3600.0), 80.0)


def test_what_nobody_can_serve_is_dark_and_without_batteries_a_vehicle_each_is_enough() -> None:
    rota = checked(pool_of(2, ("north",)), ("north", "east"), CREW, horizon_s=3600.0)
    assert ("east", 0.0, 3600.0) in [(one.station, one.from_s, one.until_s) for one in rota.dark]
    assert rota.least_fleet is None
    endless = pool_of(3, sortie=Sortie(out_s=80.0, stay_s=1e6, back_s=110.0))
    assert fleet_bound(endless, STATIONS, CREW).least_fleet == 3
    assert always_manned(checked(endless, STATIONS, CREW, horizon_s=3600.0), 80.0)
    assert checked([], STATIONS, CREW, horizon_s=3600.0).manned_share == 0.0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"horizon_s": 4.0}, "horizon_s: 4.0 must be at least one step"),
        ({"pool": [*pool_of(1), *pool_of(1)]}, "pool: 'uav-0' occurs more than once"),
        ({"stations": ("north", "north")}, "stations: ids must be unique"),
        (
            {
                "pool": [
                    PoolVehicle(id="a", sorties={"x": SORTIE}, state="outbound", station="x", from_s=1.0, until_s=2.0)
                ]
            },
            "pool.a.station: 'x' is not a station to be manned",
        ),
    ],
)
def test_what_makes_no_sense_is_refused(change: dict[str, Any], message: str) -> None:
    asked = {"pool": pool_of(2), "stations": STATIONS, "turnaround": CREW, "horizon_s": 3600.0, **change}
    with pytest.raises(ValueError, match=message):
        rota_of(**asked)


@pytest.mark.parametrize(
    ("state", "message"),
    [
        ({"state": "outbound"}, "station: a vehicle that is outbound needs one"),
        ({"state": "ready", "ready_s": 3.0}, "ready_s: a vehicle that is ready has none"),
        ({"state": "on_station", "station": "x", "from_s": 1.0, "until_s": 2.0}, "has no sortie to 'x'"),
        ({"state": "on_station", "station": "north", "from_s": 5.0, "until_s": 2.0}, "until_s: 2.0 must not be before"),
    ],
)
def test_a_vehicle_s_state_has_what_belongs_to_it(state: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        PoolVehicle(id="a", sorties={"north": SORTIE}, **state)


@st.composite
def pools(draw: st.DrawFn) -> tuple[list[PoolVehicle], tuple[str, ...], Turnaround]:
    """Pools of all sorts in any state."""
    rng = np.random.default_rng(draw(st.integers(0, 1_000_000)))
    stations = STATIONS[: draw(st.integers(1, 3))]
    turnaround = Turnaround(
        seconds=float(rng.integers(0, 400)),
        at_once=draw(st.sampled_from((None, 1, 2))),
        overlap_s=float(rng.integers(0, 30)),
        lead_s=float(rng.integers(0, 60)),
    )
    pool = []
    for k in range(draw(st.integers(0, 7))):
        sorties = {
            station: Sortie(
                out_s=float(rng.uniform(10, 200)),
                stay_s=float(rng.uniform(50, 900)),
                back_s=float(rng.uniform(10, 200)),
            )
            for station in stations
            if rng.random() < 0.9
        }
        told: dict[str, Any] = {}
        kind = draw(st.sampled_from(("ready", "flying", "inbound", "turnaround")))
        if kind == "flying" and sorties:
            begin, stay = float(rng.uniform(-600, 200)), float(rng.uniform(0, 900))
            where = list(sorties)[int(rng.integers(len(sorties)))]
            state = "outbound" if begin > 0 else "on_station"
            told = {"state": state, "station": where, "from_s": begin, "until_s": begin + stay}
        elif kind == "inbound":
            told = {"state": "inbound", "lands_s": float(rng.uniform(0, 200))}
        elif kind == "turnaround":
            told = {"state": "turnaround", "ready_s": float(rng.uniform(0, turnaround.seconds + 1.0))}
        pool.append(PoolVehicle(id=f"uav-{k}", sorties=sorties, **told))
    return tidy(pool, turnaround), stations, turnaround


def tidy(pool: list[PoolVehicle], turnaround: Turnaround) -> list[PoolVehicle]:
    """No more than two are under way to one station, and no more than the crew can are turned around."""
    kept: list[PoolVehicle] = []
    for one in pool:
        alike = [o for o in kept if o.state == one.state == "turnaround" or (one.station and o.station == one.station)]
        most = (turnaround.at_once or 9) if one.state == "turnaround" else 1
        kept.append(PoolVehicle(id=one.id, sorties=one.sorties) if len(alike) >= most else one)
    return kept


@given(pools(), st.integers(60, 5000))
@settings(max_examples=60)
def test_every_rota_can_be_flown_is_the_same_again_and_below_the_bound(
    given_pool: tuple[list[PoolVehicle], tuple[str, ...], Turnaround], horizon_s: int
) -> None:
    pool, stations, turnaround = given_pool
    rota = checked(pool, stations, turnaround, horizon_s=float(horizon_s))
    assert rota == rota_of(pool, stations, turnaround, horizon_s=float(horizon_s))
    manned_s = rota.manned_share * rota.horizon_s * len(stations)
    assert manned_s <= most_manned_s(pool, stations, turnaround, rota.horizon_s) + 1e-6


def longest_manned(n: int, sortie: tuple[int, int, int], turn: int, stations: int, horizon: int) -> int:
    """Return the most manned steps of all stations by trying all that vehicles can do."""
    out, stay, back = sortie

    def schedules() -> list[list[tuple[int, int]]]:
        rows: list[list[tuple[int, int]]] = [[]]
        done: list[list[tuple[int, int]]] = [[]]
        while rows:
            longer = []
            for row in rows:
                ready = 0 if not row else row[-1][1] + back + turn
                longer += [
                    [*row, (begin, end)]
                    for begin in range(ready + out, horizon)
                    for end in range(begin + 1, min(begin + stay, horizon) + 1)
                ]
            done += longer
            rows = longer
        return done

    whole = schedules()
    best = 0
    for picked in product(whole, repeat=n):
        there = [sum(begin <= step < end for row in picked for begin, end in row) for step in range(horizon)]
        best = max(best, sum(min(stations, count) for count in there))
    return best


@pytest.mark.parametrize("n", [1, 2])
@pytest.mark.parametrize("sortie", [(1, 3, 1), (1, 2, 1), (2, 2, 0)])
@pytest.mark.parametrize(("turn", "stations"), [(1, 1), (0, 1), (2, 2)])
def test_no_schedule_at_all_beats_the_bound_and_the_solver_reaches_the_best(
    n: int, sortie: tuple[int, int, int], turn: int, stations: int
) -> None:
    horizon = 8
    out, stay, back = (float(part) for part in sortie)
    names = STATIONS[:stations]
    pool = pool_of(n, names, Sortie(out_s=out, stay_s=stay, back_s=back))
    turnaround = Turnaround(seconds=float(turn))
    best = longest_manned(n, sortie, turn, stations, horizon)
    assert best <= most_manned_s(pool, names, turnaround, horizon) + 1e-9
    rota = checked(pool, names, turnaround, horizon_s=float(horizon), step_s=1.0)
    assert rota.manned_share * horizon * stations == pytest.approx(best)


@given(
    st.integers(1, 4), st.floats(20, 200), st.floats(200, 1200), st.floats(20, 200), st.floats(0, 400), st.floats(0, 30)
)
@settings(max_examples=60)
def test_a_fleet_below_the_bound_leaves_a_station_alone_and_one_above_it_keeps_them_manned(
    n_stations: int, out_s: float, stay_s: float, back_s: float, seconds: float, overlap_s: float
) -> None:
    stations = tuple(f"s{k}" for k in range(n_stations))
    sortie = Sortie(out_s=5.0 * round(out_s / 5), stay_s=5.0 * round(stay_s / 5), back_s=5.0 * round(back_s / 5))
    turnaround = Turnaround(seconds=5.0 * round(seconds / 5), overlap_s=5.0 * round(overlap_s / 5))
    least = fleet_bound(pool_of(1, stations, sortie), stations, turnaround).least_fleet
    assert least is not None
    cycle_s = sortie.out_s + sortie.stay_s + sortie.back_s + turnaround.seconds
    enough = checked(pool_of(least + 1, stations, sortie), stations, turnaround, horizon_s=6 * cycle_s)
    assert always_manned(enough, sortie.out_s)
    fewer = pool_of(least - 1, stations, sortie)
    long_s = (2 + 2 * least) * n_stations * cycle_s
    if fleet_bound(fewer, stations, turnaround).sustained_share < 1.0 - 2.0 / (2 + 2 * least):
        assert not always_manned(checked(fewer, stations, turnaround, horizon_s=long_s), sortie.out_s)


def test_ways_take_longer_against_the_wind_and_stays_are_shorter_the_farther_the_station_is() -> None:
    scenario = EXAMPLES["minimal"]().with_changes(
        area_m=((0.0, 0.0), (900.0, 900.0)), wind=Wind(east_mps=2.0, gust_mps=1.0)
    )
    uav = Uav(id="a", start_m=(10.0, 10.0), max_speed_mps=5.0, max_airspeed_mps=6.0, battery=Battery(usable_wh=50.0))
    near, far = sortie_of(scenario, uav, (100.0, 10.0)), sortie_of(scenario, uav, (500.0, 500.0))
    assert near is not None
    assert far is not None
    assert far.stay_s < near.stay_s
    assert far.out_s > near.out_s
    still = sortie_of(scenario.with_changes(wind=None), uav, (100.0, 10.0))
    assert still is not None
    assert still.back_s < near.back_s
    climb_s, land_s = scenario.altitude_m / Rotors().climb_mps, scenario.altitude_m / Rotors().descend_mps
    assert (still.out_s, still.back_s) == pytest.approx((climb_s + 1.1 * 18.0, land_s + 1.1 * 18.0))
    assert sortie_of(scenario, uav.model_copy(update={"battery": Battery(usable_wh=5.0)}), (100.0, 10.0)) is None
    assert sortie_of(scenario, uav.model_copy(update={"max_speed_mps": 0.0}), (100.0, 10.0)) is None
    endless = sortie_of(scenario, uav.model_copy(update={"battery": None}), (100.0, 10.0))
    assert endless is not None
    assert endless.stay_s == 1e6


def test_a_stay_that_is_flown_leaves_the_reserve_by_the_account_of_plans() -> None:
    scenario = EXAMPLES["minimal"]().with_changes(
        area_m=((0.0, 0.0), (900.0, 900.0)), wind=Wind(east_mps=2.0, gust_mps=1.0)
    )
    uav = Uav(id="a", start_m=(10.0, 10.0), max_speed_mps=5.0, max_airspeed_mps=9.0, battery=Battery(usable_wh=50.0))
    station = (310.0, 10.0)
    sortie = sortie_of(scenario, uav, station)
    air = scenario.air_for([uav])
    assert sortie is not None
    assert air is not None
    step = float(air.longest_m(np.array([[1.0, 0.0]]))[0])
    out = [(min(10.0 + step * n, 310.0), 10.0) for n in range(int(300.0 / step) + 2)]
    path = np.array([[*out, *[station] * int(sortie.stay_s / scenario.slot_duration_s)]])
    margin = account_of(air, path, np.array([path.shape[1]])).margin_wh[0]
    assert margin[-1] >= 0.0
    used_wh = 50.0 * 0.8 - margin[len(out)] - float(air.home_wh(np.array([[station]]))[0, 0])
    left_s = stay_left_s(scenario, uav, station, used_wh)
    assert left_s == pytest.approx(sortie.stay_s, abs=3 * 5.0 + 30.0)
    assert stay_left_s(scenario, uav, station, used_wh, (10.0, 10.0)) < left_s
    assert stay_left_s(scenario, uav, station, 49.0) == 0.0
    assert stay_left_s(scenario, uav, station, 40.0 - 1.25 * (40.0 - used_wh), dearer=1.25) == left_s, "what is left"
    dearer = sortie_of(scenario, uav.model_copy(update={"battery": Battery(usable_wh=62.5)}), station, dearer=1.25)
    assert dearer == sortie, "a quarter more in the battery, and everything a quarter dearer"
    assert stay_left_s(scenario, uav.model_copy(update={"battery": None}), station, 49.0) == 1e6


def with_second(rota: Rota, **changes: Any) -> Rota:
    """Return the rota with its second shift changed."""
    shifts = list(rota.shifts)
    shifts[1] = shifts[1].model_copy(update=changes)
    return rota.model_copy(update={"shifts": tuple(shifts)})


@pytest.mark.parametrize(
    ("change", "rule"),
    [
        (lambda _: {"vehicle": "nobody"}, "ids"),
        (lambda shift: {"leaves_pad_s": shift.leaves_pad_s + 10.0}, "out"),
        (lambda shift: {"lands_s": shift.lands_s - 10.0}, "back"),
        (lambda shift: {"ready_s": shift.ready_s - 10.0}, "turnaround"),
        (lambda shift: {"turned_s": shift.lands_s - 1.0}, "crew"),
        (lambda shift: {"until_s": shift.from_s + 700.0, "lands_s": shift.from_s + 900.0}, "energy"),
        (lambda shift: {"from_s": shift.from_s + 10.0}, "overlap"),
        (lambda shift: {"from_s": shift.from_s + 200.0}, "dark"),
        (lambda _: {"under_way": True}, "under_way"),
        (lambda _: {"leaves_pad_s": -10.0}, "ready"),
        (lambda shift: {"vehicle": "uav-0", "leaves_pad_s": shift.leaves_pad_s}, "ready"),
    ],
)
def test_the_check_finds_every_kind_of_fault(change: Any, rule: str) -> None:
    pool = pool_of(5)
    rota = checked(pool, STATIONS, CREW, horizon_s=3600.0)
    broken = with_second(rota, **change(rota.shifts[1]))
    assert rule in {fault.rule for fault in rota_faults(broken, pool, STATIONS, CREW)}


def test_the_check_finds_a_crew_that_would_have_too_much_to_do_and_a_share_that_is_not_true() -> None:
    pool = pool_of(6)
    rota = checked(pool, STATIONS, CREW, horizon_s=3600.0)
    [*_, last] = rota.shifts
    crowd = tuple(
        shift.model_copy(update={"turned_s": 5000.0 + k, "ready_s": 5180.0 + k}) for k, shift in enumerate(rota.shifts)
    )
    faults = rota_faults(rota.model_copy(update={"shifts": crowd}), pool, STATIONS, CREW)
    assert "crew" in {fault.rule for fault in faults}
    lied = rota.model_copy(update={"manned_share": 1.0})
    assert [fault.where for fault in rota_faults(lied, pool, STATIONS, CREW)] == ["manned_share"]
    third = last.model_copy(update={"vehicle": "uav-0"})
    packed = rota.model_copy(update={"shifts": (*rota.shifts, third, third)})
    assert "crowded" in {fault.rule for fault in rota_faults(packed, pool, STATIONS, CREW)}
