"""Simulated base stations on a service in virtual time: what goes wrong with one of them, and what users then get."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from skyfolio import sim
from skyfolio.api.lab.bench import allocations as bench
from skyfolio.api.lab.bench.radio_flight import STRIKES_AT_S, Case, Flown, fly
from skyfolio.planner import EXAMPLES

FLEET = EXAMPLES["paper"]().with_changes(altitude_m=10.0, slots=12, utility=bench.UTILITY)
CASE = Case(scenario=FLEET)
SLOT_S = 5.0
OF_UAV_1 = {"user-1", "user-2", "user-3"}


def mean_bps(flown: Flown, users: set[str], from_s: float, to_s: float) -> float:
    rows = [[rates.get(user, 0.0) for user in users] for at_s, rates in flown.rates_bps if from_s <= at_s < to_s]
    return float(np.mean(rows))


def reported_bps(flown: Flown, users: set[str], slot: int) -> float:
    return float(np.mean([flown.view.user_rates_bps[user][slot] or 0.0 for user in users]))


@pytest.fixture(scope="module")
def healthy() -> Flown:
    return fly(CASE)


def test_base_stations_serve_what_was_planned_and_report_what_users_truly_get(healthy: Flown) -> None:
    assert healthy.view.recoveries == []
    assert healthy.refused == 0
    planned = healthy.serving[0].plan.user_rates_bps
    for slot in range(2, 11):
        truly = mean_bps(healthy, set(FLEET.user_ids), slot * SLOT_S + 0.5, (slot + 1) * SLOT_S)
        assert truly == pytest.approx(np.mean([row[slot] for row in planned.values()]), rel=0.1)
        assert reported_bps(healthy, set(FLEET.user_ids), slot) == pytest.approx(truly, rel=0.05)
    assert {user: len(slots) for user, slots in healthy.view.measured_slots.items()} == dict.fromkeys(
        FLEET.user_ids, 12
    )


def test_a_deaf_base_station_serves_out_its_slots_and_its_users_are_seen_to_get_nothing(healthy: Flown) -> None:
    deaf = fly(replace(CASE, faults=(sim.StationDeaf(1),)))
    told_until_s = (STRIKES_AT_S // SLOT_S + 2) * SLOT_S
    assert mean_bps(deaf, OF_UAV_1, STRIKES_AT_S, told_until_s - 0.5) > 0.5 * mean_bps(healthy, OF_UAV_1, 30.0, 40.0)
    slot = int(told_until_s // SLOT_S)
    assert mean_bps(deaf, OF_UAV_1, told_until_s + 0.5, told_until_s + SLOT_S) == 0.0
    assert reported_bps(deaf, OF_UAV_1, slot) < 0.2 * reported_bps(healthy, OF_UAV_1, slot)
    assert "uav-1" in deaf.unacknowledged


def test_a_late_base_station_misses_nothing_of_slots_that_it_knew_before(healthy: Flown) -> None:
    late = fly(replace(CASE, faults=(sim.StationLate(1, seconds=2.0),)))
    assert mean_bps(late, OF_UAV_1, 35.0, 55.0) == pytest.approx(mean_bps(healthy, OF_UAV_1, 35.0, 55.0), rel=0.05)


def test_one_that_is_later_than_a_slot_is_refused_and_serves_nobody() -> None:
    late = fly(replace(CASE, faults=(sim.StationLate(1, seconds=7.0),)))
    assert mean_bps(late, OF_UAV_1, 46.0, 55.0) == 0.0


def test_wrong_power_is_learned_as_that_of_one_uav() -> None:
    noisy = FLEET.with_changes(channel=FLEET.channel.model_copy(update={"noise_dbm": -35.0}), slots=16)
    weak = fly(replace(CASE, scenario=noisy, faults=(sim.StationPower(1, db=-25.0),)))
    assert {report.cause for report in weak.view.recoveries} == {"rates_off"}
    learned = weak.serving[-1].plan.scenario.channel.corrections_db
    assert np.mean([learned["uav-1"].get(user, 0.0) for user in OF_UAV_1]) < -10.0
    others = [db for uav, row in learned.items() if uav != "uav-1" for db in row.values()]
    assert np.mean(others) > -4.0


def test_jammed_users_are_seen_to_get_less(healthy: Flown) -> None:
    jammed = fly(replace(CASE, faults=(sim.StationJammed(1, db=45.0),)))
    assert mean_bps(jammed, OF_UAV_1, 32.0, 40.0) < 0.7 * mean_bps(healthy, OF_UAV_1, 32.0, 40.0)
    assert reported_bps(jammed, OF_UAV_1, 7) == pytest.approx(mean_bps(jammed, OF_UAV_1, 35.0, 40.0), rel=0.1)


# -- the figures ------------------------------------------------------------------------------------------------------


def test_a_channel_that_is_6_db_worse_is_corrected_within_five_slots() -> None:
    row = bench.wrong_channel_row(bench.WRONG[3], [1])
    assert row["corrected"]["off_percent"] < 10.0 < row["uncorrected"]["off_percent"]


def test_users_of_a_lost_uav_have_service_within_a_third_of_a_slot_of_its_detection() -> None:
    row = bench.loss_row(bench.SITUATIONS[2], [1])
    assert row["at_once"]["most_slots"] <= 0.3 < 1.0 < row["with_the_new_plan"]["mean_slots"]
    figures = {"seeds": 1, "wrong_channel": [], "loss": [row]}
    assert "the operator approves after 10 s" in bench.markdown(figures)
    assert len(bench.tables(figures)) == 2
