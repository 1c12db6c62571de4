"""Kinds of channels over HTTP: plans under each, refusals that name the field, and what simulated users then get."""

from __future__ import annotations

from math import dist, pi
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient

from skyfolio import sim
from skyfolio.api.flights.base_stations import mean_gain_of, radio_truth
from skyfolio.api.lab.bench import allocations as bench
from skyfolio.api.lab.bench.radio_flight import Case, fly
from skyfolio.mavlink_bridge import east_north_to_geodetic
from skyfolio.planner import EXAMPLES, Plan, Scenario, violations
from skyfolio.planner.channels.kinds import channel_of
from tests.planner.channels.any_kind import shadowed
from tests.planner.hills import over_the_hill

CHANNELS: dict[str, dict[str, Any]] = {
    "los_probability": {"kind": "los_probability", "environment": "suburban", "noise_figure_db": 9.0},
    "3gpp_uav": {"kind": "3gpp_uav", "environment": "UMi-AV", "noise_figure_db": 9.0},
    "rician, antenna": {"antenna": {"kind": "beam", "tilt_deg": 60.0}},
    "rician, noise figure": {"noise_figure_db": 9.0, "reference_gain_db": -40.0},
    "map": shadowed(50.0, 60.0, noise_dbm=-80.0),
}


def scenario(name: str) -> Scenario:
    return EXAMPLES["paper"]().with_changes(channel=channel_of(CHANNELS[name]), slots=8)


@pytest.mark.parametrize("name", CHANNELS)
def test_a_scenario_of_each_kind_is_planned_and_comes_back_with_it(client: TestClient, name: str) -> None:
    body = scenario(name).model_dump(mode="json")
    answer = client.post("/v1/plans", params={"wait_s": 60}, json=body)
    assert answer.status_code == 200, answer.text
    made = Plan.model_validate(answer.json())
    assert violations(made) == []
    assert made.scenario.channel == channel_of(CHANNELS[name])
    assert client.get(f"/v1/plans/{made.id}").json()["scenario"]["channel"] == body["channel"]


@pytest.mark.parametrize(
    ("channel", "field", "rule"),
    [
        ({"kind": "okumura"}, "channel.kind", "los_probability"),
        ({"kind": "3gpp_uav", "carrier_hz": 1.0}, "channel.carrier_hz", "greater than or equal"),
        ({"kind": "3gpp_uav", "rician_k": 1.0}, "channel.rician_k", "not permitted"),
        ({"antenna": {"kind": "beam", "tilt_deg": 120.0}}, "channel.antenna.beam.tilt_deg", "less than or equal to 90"),
        ({"noise_dbm": -90.0, "noise_figure_db": 3.0}, "channel", "not by both"),
    ],
)
def test_a_bad_channel_is_refused_naming_field_and_rule(
    client: TestClient, paper: dict[str, Any], channel: dict[str, Any], field: str, rule: str
) -> None:
    answer = client.post("/v1/scenarios:validate", json={**paper, "channel": channel})
    assert answer.status_code == 422
    rows = answer.json()["errors"]
    assert any(row["field"] == field and rule in row["message"] for row in rows), rows


def test_an_altitude_outside_of_a_kind_s_formulas_is_refused(client: TestClient, paper: dict[str, Any]) -> None:
    answer = client.post("/v1/scenarios:validate", json={**paper, "altitude_m": 15.0, "channel": {"kind": "3gpp_uav"}})
    assert answer.status_code == 422
    assert "22.5 to 300 m" in answer.text
    assert "uavs.0" in answer.text


@pytest.mark.parametrize("name", CHANNELS)
def test_simulated_users_get_what_the_kind_gives_at_the_places_of_the_vehicles(name: str) -> None:
    given = scenario(name)
    gain = mean_gain_of(given, {7: "uav-2"})
    for east_m, north_m, up_m in ((100.0, 100.0, 60.0), (175.0, 20.0, 60.0), (400.0, 450.0, 55.0)):
        place = *east_north_to_geodetic(given.origin, east_m, north_m), up_m
        for user in given.users:
            away_m = dist((east_m, north_m), user.position_m)
            places_m = np.array(user.position_m), np.array((east_m, north_m))
            by_kind = given.channel.gain_at(away_m, up_m, places_m=places_m)
            assert gain(7, user.id, place) == pytest.approx(by_kind, rel=1e-6)


def test_a_hill_between_them_costs_simulated_users_what_the_kind_says() -> None:
    given = over_the_hill(channel=channel_of({"kind": "los_probability", "noise_figure_db": 9.0}))
    gain = mean_gain_of(given, {1: "west"})
    hidden = gain(1, "user-0", (*east_north_to_geodetic(given.origin, 60.0, 250.0), 50.0))
    free = (299_792_458.0 / (4.0 * pi * 2e9)) ** 2 / (380.0**2 + 50.0**2)  # home and user stand equally high
    assert hidden == pytest.approx(free * 10**-2.0, rel=0.02)  # 20 dB without line of sight, table II
    beside = gain(1, "user-0", (*east_north_to_geodetic(given.origin, 440.0, 200.0), 50.0))
    assert beside > 20.0 * hidden


def test_simulated_users_get_what_was_planned_under_a_city_s_channel() -> None:
    flown = fly(Case(scenario=scenario("3gpp_uav").with_changes(slots=12, utility=bench.UTILITY)))
    planned = flown.serving[0].plan.user_rates_bps
    for slot in range(3, 11):
        got = [sum(rates.values()) for at_s, rates in flown.rates_bps if slot * 5.0 + 0.5 <= at_s < slot * 5.0 + 5.0]
        assert np.mean(got) == pytest.approx(sum(row[slot] for row in planned.values()), rel=0.1)


def test_noise_of_simulated_receivers_is_that_of_the_band_of_their_base_station() -> None:
    easy = scenario("rician, noise figure")
    first = replace_band(easy, 40_000.0)
    specs = [sim.VehicleSpec(n, 47.0, 8.0 + n / 1000.0) for n in (1, 2, 3)]
    fleet = sim.Fleet(specs, clock=sim.VirtualClock())
    for vehicle in fleet.vehicles.values():
        dynamics = vehicle.autopilot.dynamics
        dynamics.body = dynamics.body._replace(up_m=60.0)
        vehicle.base_station.hear(1, [sim.Served(-1.0, 1e6, {"user-1": 1000.0})], 0.0)
        vehicle.base_station.acknowledge(1)

    def sinr_db(of: Scenario) -> dict[int, float]:
        return {one.system_id: one.sinr_db for one in radio_truth(fleet, of).received()}

    narrow, wide = sinr_db(easy), sinr_db(first)
    assert wide[1] == pytest.approx(narrow[1] - 6.02, abs=0.2)
    assert wide[2] >= narrow[2]


def replace_band(of: Scenario, hertz: float) -> Scenario:
    return of.with_changes(uavs=(of.uavs[0].model_copy(update={"bandwidth_hz": hertz}), *of.uavs[1:]))
