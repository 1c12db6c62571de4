"""What a vehicle draws in flight: the power it reports, Wh since it was armed, and samples with fresh velocities."""

from typing import Any

import pytest

from skyfolio.mavlink_bridge.power_log import LONGEST_GAP_S, MOST_SAMPLES, PowerLog, power_w_of
from skyfolio.mavlink_bridge.telemetry import TelemetryState
from tests.mavlink_bridge.test_telemetry import HEARTBEAT, POSITION

STATUS: dict[str, Any] = {"battery_remaining": 90, "voltage_battery": 16_000, "current_battery": 1_250}


def test_power_is_voltage_times_current_and_unknown_without_either() -> None:
    assert power_w_of(STATUS) == pytest.approx(200.0)
    assert power_w_of({**STATUS, "voltage_battery": 65535}) is None
    assert power_w_of({**STATUS, "current_battery": -1}) is None
    assert power_w_of({"battery_remaining": 90}) is None


def test_energy_is_counted_from_arming_on_and_gaps_are_not_guessed() -> None:
    log = PowerLog()
    log.add(20.0, 0.0, armed=False)
    assert log.used_wh is None
    log.arm()
    for now_s, power_w in ((10.0, 100.0), (20.0, 200.0), (20.0 + 10 * LONGEST_GAP_S, 200.0)):
        log.add(power_w, now_s, armed=True)
    assert log.used_wh == pytest.approx((150.0 * 10.0 + 200.0 * LONGEST_GAP_S) / 3600.0)
    log.add(None, 500.0, armed=True)
    log.add(100.0, 600.0, armed=True)
    assert log.used_wh == pytest.approx((150.0 * 10.0 + 200.0 * LONGEST_GAP_S) / 3600.0)


def test_samples_have_a_fresh_velocity_and_the_oldest_are_dropped() -> None:
    log = PowerLog()
    log.add(150.0, 10.0, armed=True)
    log.sample(POSITION, 5.0, 10.0)
    assert not log.samples
    log.sample({**POSITION, "vz": -120}, 9.5, 10.0)
    assert tuple(log.samples[0]) == pytest.approx((150.0, -0.2, 1.5, 1.2))
    for _ in range(MOST_SAMPLES + 5):
        log.sample(POSITION, 9.5, 10.0)
    assert len(log.samples) == MOST_SAMPLES


def test_telemetry_tells_power_and_energy_and_samples_only_in_the_air() -> None:
    state = TelemetryState(1)
    state.fold("HEARTBEAT", HEARTBEAT, 0.0)
    state.fold("GLOBAL_POSITION_INT", POSITION, 1.0)
    state.fold("SYS_STATUS", STATUS, 1.0)
    assert not state.power.samples
    state.fold("EXTENDED_SYS_STATE", {"landed_state": 2, "vtol_state": 0}, 1.5)
    state.fold("SYS_STATUS", STATUS, 2.0)
    now = state.snapshot()
    assert now is not None
    assert now.power_w == pytest.approx(200.0)
    assert now.used_wh == pytest.approx(200.0 / 3600.0)
    assert len(state.power.samples) == 1
