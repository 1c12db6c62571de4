"""Batteries in operations: refused before take-off, watched in flight, and rotors fitted to what was reported."""

from types import SimpleNamespace
from typing import Any, cast

import pytest

from skyfolio.api.common.errors import ConflictError
from skyfolio.api.fleet.rotor_fit import rotors_of
from skyfolio.api.flights.energy import EnergyWatch, energy_view, used_by_slot_wh
from skyfolio.api.lab.bench.energy import Air, energy_figures, fitted, markdown, table
from skyfolio.mavlink_bridge import Autopilot, FleetLink
from skyfolio.mavlink_bridge.power_log import PowerSample
from skyfolio.mavlink_bridge.telemetry import Telemetry
from skyfolio.planner import EXAMPLES, MaxIterations, Plan, Scenario, plan, remaining, replan, violations
from skyfolio.planner.endurance import proven_by_wh
from skyfolio.planner.energy.power import law_of
from skyfolio.planner.scenario import Battery, Rotors, Wind


def planned(usable_wh: float = 40.0) -> Plan:
    easy = EXAMPLES["minimal"]()
    uavs = tuple(uav.model_copy(update={"battery": Battery(usable_wh=usable_wh)}) for uav in easy.uavs)
    return plan(easy.with_changes(uavs=uavs), n_starts=1, stop=MaxIterations(1))


def watch(made: Plan, charge: float | None, elapsed_s: float | None = 10.0) -> EnergyWatch:
    told = cast("Telemetry", SimpleNamespace(battery=charge))
    return EnergyWatch(lambda: made, lambda: elapsed_s, lambda _uav: told)


def test_a_uav_lacks_energy_once_it_has_used_more_than_its_margin_beyond_the_plan() -> None:
    made = planned()
    slots = 10.0 / made.scenario.slot_duration_s
    used, margin = made.energy_wh["uav-1"], min(made.energy_margin_wh["uav-1"])
    assert slots == int(slots)
    as_planned = used[int(slots) - 1]
    enough, little = 1.0 - (as_planned + margin) / 40.0, 1.0 - (as_planned + margin + 1.0) / 40.0
    assert watch(made, enough).lacking("uav-1") is None
    said = watch(made, little).lacking("uav-1")
    assert said is not None
    assert "1.0 Wh too little to fly on and come home with its reserve" in said
    assert watch(made, little, elapsed_s=None).lacking("uav-1") is None
    assert watch(made, None).lacking("uav-1") is None
    assert watch(EXAMPLES_PLAN, little).lacking("uav-1") is None


EXAMPLES_PLAN = plan(EXAMPLES["minimal"](), n_starts=1, stop=MaxIterations(1))


def test_on_its_way_home_a_uav_does_not_lack_what_the_way_home_takes() -> None:
    made = planned()
    ends_s = made.scenario.slots * made.scenario.slot_duration_s
    empty = 1.0 - (made.energy_wh["uav-1"][-1] + min(made.energy_margin_wh["uav-1"]) + 5.0) / 40.0
    assert watch(made, empty, elapsed_s=ends_s).lacking("uav-1") is not None
    assert watch(made, empty, elapsed_s=ends_s + 1.0).lacking("uav-1") is None
    assert watch(made, empty, elapsed_s=ends_s + 1.0).outlook("uav-1") is None


def test_what_the_gauge_says_counts_in_a_replan_only_where_it_is_more_than_the_plan_has_proven() -> None:
    made = planned()
    slot_s = made.scenario.slot_duration_s
    now, then = (proven_by_wh(made, "uav-1", slots) or 0.0 for slots in (1, 2))
    assert 0.0 < now < then

    def used(charge: float | None) -> dict[str, float]:
        told = cast("Telemetry", SimpleNamespace(battery=charge))
        return used_by_slot_wh(made, ["uav-1", "nobody"], 2, slot_s, lambda _uav: told)

    assert used(None) == used(1.0) == used(1.0 - now / 40.0) == {}
    assert used(1.0 - (now + 0.39) / 40.0) == {}  # less than a per cent of the battery: that may be rounding
    assert used(1.0 - (now + 5.0) / 40.0) == {"uav-1": pytest.approx(then + 5.0)}
    assert used_by_slot_wh(EXAMPLES_PLAN, ["uav-1"], 2, slot_s, lambda _uav: None) == {}


def test_a_replan_counts_on_what_a_battery_was_measured_to_hold() -> None:
    made = planned()
    usual, _ = remaining(made, ["uav-2"], 2)
    more, _ = remaining(made, ["uav-2"], 2, used_wh={"uav-1": 20.0})
    less, _ = remaining(made, ["uav-2"], 2, used_wh={"uav-1": 0.0})
    proven = used_wh_of(usual)
    assert proven == pytest.approx(proven_by_wh(made, "uav-1", 2))
    assert used_wh_of(more) == 20.0
    assert used_wh_of(less) == proven  # a gauge that says less is not believed


def used_wh_of(scenario: Scenario) -> float:
    battery = scenario.uav("uav-1").battery
    assert battery is not None
    assert battery.used_wh is not None
    return battery.used_wh


def test_a_survivor_that_is_nearly_empty_goes_home_at_once_and_leaves_the_others_their_plan() -> None:
    made = planned()
    rest = replan(made, at_slot=1, used_wh={"uav-1": 39.9}, n_starts=1, stop=MaxIterations(1))
    assert rest.scenario.uav("uav-1").leaves_at_slot == 1
    assert rest.scenario.uav("uav-2").leaves_at_slot is None
    assert violations(rest) == []


def test_clients_see_the_outlook() -> None:
    view = energy_view(watch(planned(), 0.9).outlook("uav-1"))
    assert view is not None
    assert view.used_wh == pytest.approx(4.0)
    assert view.at_end_wh > view.used_wh
    assert energy_view(None) is None


def test_rotors_are_fitted_to_the_reports_of_a_vehicle_and_not_before_there_are_enough() -> None:
    true = Rotors(blade_w=120.0, induced_w=110.0)
    wind = Wind(east_mps=3.0)
    power = [float(law_of([true]).expected_w(_array(speed))[0]) for speed in range(12)]
    samples = [PowerSample(power[speed], 3.0 + speed, 0.0, 0.0) for speed in range(12)] * 5
    descents = [PowerSample(20.0, 0.0, 0.0, -2.0)] * 50

    def link(kept: list[PowerSample]) -> FleetLink:
        return cast("FleetLink", SimpleNamespace(power_samples=lambda _system: kept))

    fit = rotors_of(link(samples + descents), "uav-1", 1, wind)
    assert fit.samples == 60
    assert fit.rms_w < 1.0
    assert (fit.least_mps, fit.most_mps) == (0.0, 11.0)
    with pytest.raises(ConflictError, match="'uav-1' has reported its power in flight 20 times"):
        rotors_of(link(samples[:20] + descents), "uav-1", 1, wind)


def _array(speed: float) -> Any:
    return law_of([Rotors()]).blade_w * 0.0 + speed


def test_a_fit_in_flight_predicts_the_energy_of_other_flights_in_other_winds() -> None:
    figures = energy_figures(6)
    assert figures["all"]["flights"] == 6
    assert {row["autopilot"] for row in figures["rows"]} == {"px4", "ardupilot"}
    assert figures["all"]["error_max"] <= figures["target_error"]
    assert [row["expected_wh"] for row in figures["rows"]] == [row["expected_wh"] for row in energy_figures(6)["rows"]]
    assert "| px4 | 3 |" in markdown(figures)
    assert table(figures).row_count == 3


def test_a_planner_that_does_not_know_the_vehicle_predicts_worse() -> None:
    fit = fitted(Autopilot.PX4)
    calm = law_of([fit.rotors, Rotors()]).expected_w(_array(5.0))
    assert abs(calm[1] / calm[0] - 1.0) > 0.1
    assert Air(wind_mps=3.0, towards_rad=0.0, gust_mps=0.5).wind().gust_mps == pytest.approx(1.5)
