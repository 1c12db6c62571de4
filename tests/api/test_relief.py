"""Stations that stay manned: vehicles relieve each other on batteries of eight minutes."""

from __future__ import annotations

from typing import Any

import pytest

from skyfolio import sim
from skyfolio.api.flights.operation_views import State
from skyfolio.api.store.event_log import Event
from skyfolio.planner.energy.parts import Rotors
from tests.api.endless import Apart, ended
from tests.api.relief import BATTERY, EVERY, HORIZON, ONE_STATION, ROTORS, SLOT_S, THREE_STATIONS, pooled, whole
from tests.api.sky import Sky

pytestmark = [pytest.mark.long, pytest.mark.timeout(3600)]
CALM: dict[str, Any] = {"plan_ahead": False}
ONE, THREE = whole(ONE_STATION, 3), whole(THREE_STATIONS, 7)
ORDERED_WITHIN_S = 10.0
SETTLED_SLOTS = 20
"""Until then vehicles are on their first way to their stations."""


def take_off(sky: Sky, terms: Any, duration_s: float) -> str:
    return sky.take_off(duration_s=duration_s, horizon_slots=HORIZON, replan_every_slots=EVERY, relief=terms)


def assert_served(sky: Sky, operation_id: str, least: float = 0.9) -> None:
    """No user that is served at all gets less than that share of what it usually gets, in any slot."""
    rows = sky.http.get(f"/v1/operations/{operation_id}/rates", params={"limit": 10_000}).json()[SETTLED_SLOTS:]
    totals = [sum(rate or 0.0 for rate in row["rates_bps"].values()) for row in rows]
    usual = sorted(totals)[len(totals) // 2]
    low = {
        row["slot"]: round(total / usual, 2) for row, total in zip(rows, totals, strict=True) if total < least * usual
    }
    assert not low, low


def assert_none_fell(sky: Sky, apart: Apart) -> None:
    """Every vehicle is whole, and none has landed with less than its reserve, by the simulator's ground truth."""
    for system_id, vehicle in sky.fleet.vehicles.items():
        assert not sky.fleet.truth.happened("crashed", system_id), system_id
        assert vehicle.alive, system_id
    assert apart.landings, "somebody has landed"
    short = [(system_id, round(share, 3)) for system_id, share in apart.landings if share < BATTERY.reserve_share]
    assert not short, short


@pytest.mark.e2e  # half a minute of CPU
def test_one_station_is_manned_for_twenty_minutes_by_three_vehicles() -> None:
    with pooled(ONE, 1, **CALM) as (sky, terms):
        apart = Apart(sky)
        operation_id = take_off(sky, terms, 1200.0)
        view = ended(sky, operation_id, within_s=1600.0)
        assert (view.state, view.error, view.lost) == (State.COMPLETED, None, [])
        assert view.relief is not None
        assert view.relief.reliefs >= 3
        assert apart.closest_m >= ONE.min_separation_m
        assert_served(sky, operation_id)
        assert_none_fell(sky, apart)


@pytest.mark.parametrize("rotors", [Rotors(), ROTORS], ids=["dearer than planned", "as planned"])
def test_who_is_not_relieved_is_called_home_and_lands_with_its_reserve(rotors: Rotors) -> None:
    with pooled(whole(ONE_STATION, 2, rotors), 1, **CALM) as (sky, terms):
        apart = Apart(sky)
        operation_id = take_off(sky, terms, 1000.0)
        sky.inject(sim.GpsLoss(2))  # the only one that could relieve it does not arm
        sky.until(operation_id, lambda view: view.lost == ["uav-1"])
        lost = sky.told(operation_id, "uav_lost")
        assert [(one["uav_id"], one["cause"]) for one in lost] == [("uav-1", "battery")]
        assert "sent home before its reserve is drawn on" in lost[0]["detail"]
        sky.wait(lambda: sky.told(operation_id, "station"), "it is told that the station is dark")
        dark = [(one["station"], one["is_dark"]) for one in sky.told(operation_id, "station")]
        assert dark == [("station-1", True)]
        journal = sky.http.get(f"/v1/operations/{operation_id}/journal").json()
        assert any(entry["step"] == "detected" and entry["data"]["cause"] == "battery" for entry in journal)
        sky.wait(lambda: apart.landings, "it lands")
        assert_none_fell(sky, apart)


def test_who_is_called_home_counts_again_when_it_has_landed_and_a_spare_has_its_station() -> None:
    with pooled(ONE, 1, **CALM) as (sky, terms):
        operation_id = take_off(sky, terms, 420.0)
        sky.let_pass(60.0)
        sky.inject(sim.LowBattery(1, 0.36))  # a cell has failed: no reliever could be there in time
        sky.until(operation_id, lambda view: view.lost == ["uav-1"])
        sky.wait(lambda: sky.told(operation_id, "station"), "it is told that the station is dark")
        view = sky.until(
            operation_id, lambda view: view.relief is not None and view.relief.stations["station-1"].manned_by
        )
        assert [one["is_dark"] for one in sky.told(operation_id, "station")] == [True, False]
        view = sky.until(
            operation_id, lambda view: view.relief is not None and view.relief.pool["uav-1"].state == "ready"
        )
        assert view.lost == []
        states = [one["state"] for one in sky.told(operation_id, "pool") if one["uav_id"] == "uav-1"]
        assert states == ["inbound", "turnaround", "ready"]
        view = ended(sky, operation_id)
        assert (view.state, view.error, view.lost) == (State.COMPLETED, None, [])


@pytest.mark.e2e  # half a minute of CPU
def test_three_stations_are_manned_by_seven_vehicles() -> None:
    with pooled(THREE, 3, **CALM) as (sky, terms):
        apart = Apart(sky)
        operation_id = take_off(sky, terms, 700.0)
        sky.let_pass(690.0)
        beside = [event.system_id for event in sky.fleet.truth.events if event.kind == "off_pad"]
        assert not beside, "the crew finds who was relieved on its pad"
        view = ended(sky, operation_id, within_s=1100.0)
        assert (view.state, view.error, view.lost) == (State.COMPLETED, None, [])
        assert view.relief is not None
        assert view.relief.reliefs >= 3
        assert apart.closest_m >= THREE.min_separation_m
        assert_served(sky, operation_id)
        assert_none_fell(sky, apart)


@pytest.mark.parametrize("stations", [1, 3])
def test_a_loss_on_station_orders_a_spare_at_once(stations: int) -> None:
    with pooled(ONE if stations == 1 else THREE, stations, **CALM) as (sky, terms):
        apart = Apart(sky)
        operation_id = take_off(sky, terms, 420.0)
        sky.let_pass(60.0)
        sky.inject(sim.Kill(1))
        view = sky.until(operation_id, lambda view: view.lost == ["uav-1"])
        verdict_s = sky.now_s
        view = sky.until(
            operation_id,
            lambda view: view.relief is not None and any(one.state == "outbound" for one in view.relief.pool.values()),
        )
        assert sky.now_s - verdict_s <= ORDERED_WITHIN_S
        view = sky.until(
            operation_id, lambda view: view.relief is not None and view.relief.stations["station-1"].manned_by
        )
        assert view.relief is not None
        assert view.relief.pool["uav-1"].state == "out_of_service"
        view = ended(sky, operation_id)
        assert (view.state, view.error) == (State.COMPLETED, None)
        assert apart.closest_m >= ONE.min_separation_m


def test_a_vehicle_that_does_not_arm_is_passed_over_for_the_next_one() -> None:
    with pooled(ONE, 1, **CALM) as (sky, terms):
        operation_id = take_off(sky, terms, 700.0)
        deaf: list[str] = []

        def take_its_position(event: Event) -> None:
            if event.kind == "pool" and event.data["state"] == "outbound" and not deaf:
                deaf.append(event.data["uav_id"])
                sky.inject(sim.GpsLoss(ONE.uav_ids.index(deaf[0]) + 1))

        sky.ground.on_event = take_its_position
        view = ended(sky, operation_id, within_s=1000.0)
        assert (view.state, view.error, view.lost) == (State.COMPLETED, None, [])
        assert view.relief is not None
        assert view.relief.reliefs >= 1
        told = sky.told(operation_id, "pool")
        refusals = [one["because"] for one in told if one["uav_id"] == deaf[0] and one["state"] == "ready"]
        assert refusals
        relievers = [one["uav_id"] for one in told if one["state"] == "on_station"]
        assert deaf[0] not in relievers
        assert_served(sky, operation_id)


@pytest.mark.parametrize("state", ["outbound", "on_station", "inbound", "turnaround"])
def test_wherever_a_relief_is_when_the_service_is_killed_the_next_one_goes_on(state: str) -> None:
    with pooled(ONE, 1, **CALM) as (sky, terms):
        apart = Apart(sky)
        operation_id = take_off(sky, terms, 800.0)
        sky.wait(
            lambda: any(one["state"] == state for one in sky.told(operation_id, "pool")),
            f"nobody is {state}",
            within_s=700.0,
        )
        sky.let_pass(2.0)
        sky.ground.kill()
        sky.let_pass(3.0)
        sky.start()
        view = ended(sky, operation_id, within_s=1200.0)
        assert (view.state, view.error, view.lost) == (State.COMPLETED, None, [])
        assert view.relief is not None
        assert view.relief.reliefs >= 1
        assert view.endless is not None
        assert view.endless.planned_slots == 800.0 / SLOT_S
        assert apart.closest_m >= ONE.min_separation_m
        assert_none_fell(sky, apart)


def test_what_is_no_pool_is_refused_with_field_and_rule() -> None:
    with pooled(ONE, 1, **CALM) as (sky, terms):
        body = {"plan_id": sky.plan.id, "relief": terms.model_dump(mode="json")}
        for wrong, named in (
            ({"guidance": "stream"}, "guidance must be mission"),
            ({"relief": {"pool": [ONE.uavs[0].model_dump(mode="json")]}}, "flies the first plan"),
            ({"relief": {"pool": [{"id": "nobody", "start_m": [90.0, 90.0]}]}}, "not registered"),
            ({"relief": {"pool": [{"id": "uav-2", "start_m": [180.0, 151.0]}]}}, "min_separation_m"),
        ):
            answer = sky.http.post("/v1/operations", json={**body, **wrong})
            assert (answer.status_code, named in answer.text) == (422, True), answer.text
