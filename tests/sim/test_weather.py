"""sim.weather and sim.slots: what wind and satellites do to a hover, and how far a schedule is missed"""

import math
from statistics import mean, pstdev
from typing import Any

import pytest

from skyfolio.sim import Fleet, Mode, SlotGrid, VirtualClock, Weather, WindFront, grid_of
from skyfolio.sim.weather import Air

HOME = (47.397742, 8.545594)


def hover(weather: Weather, seconds: float = 60.0) -> tuple[Fleet, list[tuple[float, float]]]:
    """Return a fleet of one after a hover, and where it was (east, north) ten times a second."""
    fleet = Fleet(grid_of(1, *HOME), clock=VirtualClock(), weather=weather)
    autopilot = fleet.vehicles[1].autopilot
    autopilot.arm()
    autopilot.takeoff(20.0)
    fleet.step_to(20.0)
    track = []
    for n in range(round(seconds * 10)):
        fleet.step_to(20.0 + n / 10)
        track.append((autopilot.body.east_m, autopilot.body.north_m))
    return fleet, track


def test_in_still_air_a_hover_stands() -> None:
    _, track = hover(Weather(), 10.0)
    assert max(math.hypot(*place) for place in track) < 0.05


def test_gusts_move_a_hover_by_decimetres_and_a_steady_wind_does_not() -> None:
    _, steady = hover(Weather(wind_east_mps=8.0), 10.0)
    assert max(math.hypot(*place) for place in steady) < 0.05
    _, gusty = hover(Weather(wind_east_mps=8.0, gust_mps=2.0))
    assert 0.05 < pstdev([east for east, _ in gusty]) < 1.0


def test_a_storm_blows_it_away() -> None:
    _, track = hover(Weather(wind_east_mps=25.0), 20.0)
    assert track[-1][0] > 100.0


def test_the_vehicle_follows_its_estimate_and_the_truth_wanders() -> None:
    fleet, track = hover(Weather(gps_m=2.0, gps_s=10.0), 120.0)
    assert 0.5 < pstdev([east for east, _ in track]) < 4.0
    autopilot = fleet.vehicles[1].autopilot
    position: Any = autopilot.telemetry.build(33)
    east, north = autopilot.frame.to_local(position.lat / 1e7, position.lon / 1e7)
    assert autopilot.seen.distance_to(east, north) < 0.02
    assert autopilot.seen.distance_to(0.0, 0.0) < 1.5
    assert autopilot.body.distance_to(east, north) > 0.01


def test_headwind_costs_battery() -> None:
    calm, _ = hover(Weather(), 30.0)
    windy, _ = hover(Weather(wind_north_mps=12.0), 30.0)
    assert windy.vehicles[1].autopilot.battery.share != calm.vehicles[1].autopilot.battery.share


def test_gusts_have_the_size_they_were_given() -> None:
    air = Air(Weather(gust_mps=2.0, gust_s=1.0), "seed")
    east = []
    for step in range(20_000):
        air.step(0.5 * step, 0.5, satellites=True)
        east.append(air.gust_mps[0])
    assert mean(east) == pytest.approx(0.0, abs=0.15)
    assert pstdev(east) == pytest.approx(2.0, rel=0.05)


def test_a_front_changes_the_wind_within_its_ramp_and_the_next_one_begins_from_there() -> None:
    fronts = (
        WindFront(at_s=100.0, east_mps=6.0, gust_mps=1.0, ramp_s=50.0),
        WindFront(at_s=125.0, north_mps=-4.0, ramp_s=100.0),
    )
    weather = Weather(wind_north_mps=2.0, fronts=fronts)
    assert weather.wind_at(99.0) == (0.0, 2.0, 0.0)
    assert weather.wind_at(110.0) == pytest.approx((1.2, 1.6, 0.2))
    assert weather.wind_at(125.0) == pytest.approx((3.0, 1.0, 0.5))
    assert weather.wind_at(175.0) == pytest.approx((1.5, -1.5, 0.25))
    assert weather.wind_at(1e6) == pytest.approx((0.0, -4.0, 0.0))


def test_a_front_reaches_those_who_fly_and_is_reported() -> None:
    fronts = (WindFront(at_s=30.0, north_mps=12.0, ramp_s=0.0),)
    calm, _ = hover(Weather(), 60.0)
    windy, _ = hover(Weather(fronts=fronts), 60.0)
    assert windy.vehicles[1].autopilot.air.wind_mps == (0.0, 12.0)
    assert windy.vehicles[1].autopilot.battery.share != calm.vehicles[1].autopilot.battery.share
    (front,) = windy.truth.happened("wind_front")
    assert front.t_s == pytest.approx(30.0, abs=0.06)
    assert front.system_id == 0
    assert front.detail == {"east_mps": 0.0, "north_mps": 12.0, "gust_mps": 0.0, "ramp_s": 0.0}


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"gust_mps": -1.0}, "gust_mps must not be negative"),
        ({"fronts": (WindFront(at_s=9.0), WindFront(at_s=3.0))}, "fronts must be in order of at_s"),
        ({"gps_s": 0.0}, "gps_s must be above 0"),
        ({"wind_east_mps": math.nan}, "wind_east_mps must be a finite number"),
    ],
)
def test_impossible_weather_is_refused(values: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        Weather(**values)


def test_the_distance_from_the_schedule_is_reported_when_each_slot_begins() -> None:
    fleet, _ = hover(Weather(), 1.0)
    frame = fleet.vehicles[1].autopilot.frame
    points = [frame.to_geodetic(0.0, 10.0 * slot) for slot in range(4)]
    fleet.start_slots(5.0, points={1: points})
    fleet.vehicles[1].autopilot.reposition(0.0, 100.0, None, 2.0)
    fleet.step_to(fleet.now_s + 30.0)
    slots = fleet.truth.happened("slot")
    assert [event.detail["slot"] for event in slots] == [1, 2, 3]
    behind = [event.detail["error_m"] for event in slots]
    assert behind[0] == pytest.approx(0.5, abs=0.5)
    assert fleet.vehicles[1].mode is Mode.HOLD


def test_a_grid_needs_a_duration() -> None:
    with pytest.raises(ValueError, match="duration_s must be a finite number above 0"):
        SlotGrid(0.0, 0.0, {})


def test_a_power_module_measures_the_power_that_is_drawn() -> None:
    fleet, _ = hover(Weather(wind_north_mps=5.0), 10.0)
    battery = fleet.vehicles[1].autopilot.battery
    assert battery.power_w > 100.0
    assert battery.voltage_v * battery.current_a == pytest.approx(battery.power_w)
