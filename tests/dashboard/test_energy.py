"""What pages show of ground and batteries: altitudes, how UAVs come home by the plan, and what they have used."""

from __future__ import annotations

import pytest

from skyfolio.api.dashboard import live, map_scene, plan_metrics
from skyfolio.api.dashboard.map_scene import Spot
from skyfolio.api.dashboard.views import Operation, Vehicle
from skyfolio.planner import EXAMPLES, MaxIterations, Plan, plan
from skyfolio.planner.energy.outlook import landing_of, outlook_of
from skyfolio.planner.scenario import Battery


@pytest.fixture(scope="module")
def powered() -> Plan:
    """One of the UAVs has a battery."""
    minimal = EXAMPLES["minimal"]()
    first, *others = minimal.uavs
    full = first.model_copy(update={"battery": Battery(usable_wh=60.0)})
    return plan(minimal.with_changes(uavs=(full, *others)), n_starts=1, stop=MaxIterations(2))


def vehicle(battery_percent: float | None) -> Vehicle:
    told = {"uav_id": "uav-1", "system_id": 1, "armed": True, "mode": "mission", "battery_percent": battery_percent}
    return Vehicle.model_validate(told)


def test_the_plan_page_has_a_row_for_each_uav_with_a_battery(powered: Plan, small_plan: Plan) -> None:
    landing = landing_of(powered, "uav-1")
    assert landing is not None
    [row] = plan_metrics.energy(powered)
    share = round(100 * landing.home_wh / 60.0)
    assert row[:3] == ("uav-1", f"{landing.used_wh:.1f}", f"{landing.home_wh:.1f} ({share} %)".replace(" %", "%"))
    assert row[3:] == ("12.0", f"{landing.spare_wh:.1f}")
    assert len(row) == len(plan_metrics.ENERGY_HEAD)
    assert plan_metrics.energy(small_plan) == []


def test_the_plan_page_has_the_altitudes_of_a_plan_that_has_some_in_their_datum(small_plan: Plan) -> None:
    assert plan_metrics.altitudes(small_plan)[0] == []
    first, *others = small_plan.scenario.uavs
    leaving = small_plan.scenario.with_changes(uavs=(first.model_copy(update={"leaves_at_slot": 2}), *others))
    rows = {uav: [60.0, 90.4, *[500.0] * (leaving.slots - 2)] for uav in leaving.uav_ids}
    flown = small_plan.model_copy(update={"scenario": leaving, "altitudes_m": rows})
    assert plan_metrics.altitudes(flown) == (
        [("uav-1", "60", "90"), ("uav-2", "60", "500")], ("altitude, m above home", "lowest", "highest"),
    )  # fmt: skip


def test_the_ground_of_a_scenario_is_told_in_words() -> None:
    assert map_scene.ground_words({"terrain": {"heights_m": [[530.2, 540.0], [655.1, 600.0]]}}) == [
        "ground 530 to 655 m above sea level"
    ]
    assert map_scene.ground_words({}) == map_scene.ground_words({"terrain": None}) == []


def test_in_flight_the_energy_is_that_of_its_own_gauge_at_this_moment_of_the_plan(powered: Plan) -> None:
    slot_s = powered.scenario.slot_duration_s
    told = live.energy_of(powered, "uav-1", 2.5 * slot_s, vehicle(80.0))
    assert told == outlook_of(powered, "uav-1", 2.5, 0.8)
    assert told is not None
    assert told.used_wh == pytest.approx(12.0)


def test_nothing_is_shown_where_nothing_is_known(powered: Plan, small_plan: Plan) -> None:
    assert live.energy_of(None, "uav-1", 1.0, vehicle(80.0)) is None
    assert live.energy_of(powered, "uav-1", None, vehicle(80.0)) is None
    assert live.energy_of(powered, "uav-1", -3.0, vehicle(80.0)) is None
    assert live.energy_of(powered, "uav-1", 1.0, vehicle(None)) is None
    assert live.energy_of(powered, "uav-1", 1.0, None) is None
    assert live.energy_of(powered, "uav-2", 1.0, vehicle(80.0)) is None
    assert live.energy_of(powered, "stranger", 1.0, vehicle(80.0)) is None
    assert live.energy_of(small_plan, "uav-1", 1.0, vehicle(80.0)) is None


def test_a_row_of_the_fleet_has_what_was_used_and_what_is_spare(powered: Plan, flying: Operation) -> None:
    energy = live.energy_of(powered, "uav-1", 5.0, vehicle(10.0))
    assert energy is not None
    assert energy.margin_wh < 0  # it has used far more than planned
    rows = map_scene.rows(
        [Spot(uav_id="uav-1", at_m=None, vehicle=vehicle(10.0), energy=energy), Spot(uav_id="uav-2", at_m=None)], flying
    )
    by_id = {row["id"]: row["energy"] for row in rows}
    assert by_id == {"uav-1": [energy.used_wh, energy.margin_wh], "uav-2": None}
