from __future__ import annotations

from typing import Any

import pytest

from skyfolio.mavlink_bridge import FlightMode, LandedState
from skyfolio.mavlink_bridge.autopilots import Autopilot
from skyfolio.mavlink_bridge.e7 import place_of
from skyfolio.mavlink_bridge.px4 import PX4
from skyfolio.mavlink_bridge.telemetry import TelemetryState

POSITION: dict[str, Any] = {
    "time_boot_ms": 12_000,
    "lat": 473977420,
    "lon": 85455940,
    "alt": 548_000,
    "relative_alt": 60_000,
    "vx": 150,
    "vy": -20,
    "vz": 0,
    "hdg": 0,
}
HEARTBEAT: dict[str, Any] = {"custom_mode": 4 << 16 | 4 << 24, "base_mode": 157, "type": 2, "autopilot": 12}


@pytest.mark.parametrize(
    ("main", "sub", "mode"),
    [
        (4, 2, FlightMode.TAKEOFF),
        (4, 3, FlightMode.HOLD),
        (4, 4, FlightMode.MISSION),
        (4, 5, FlightMode.RETURN),
        (4, 6, FlightMode.LAND),
        (3, 0, FlightMode.POSITION),
        (6, 0, FlightMode.OFFBOARD),
        (4, 99, FlightMode.OTHER),
        (99, 0, FlightMode.OTHER),
    ],
)
def test_custom_mode_is_read_as_px4_writes_it(main: int, sub: int, mode: FlightMode) -> None:
    assert PX4.read_mode(main << 16 | sub << 24) is mode


def test_there_is_no_snapshot_before_both_a_heartbeat_and_a_position() -> None:
    state = TelemetryState(1)
    assert state.snapshot() is None
    state.fold("GLOBAL_POSITION_INT", POSITION, 1.0)
    assert state.snapshot() is None
    state.fold("HEARTBEAT", HEARTBEAT, 1.5)
    assert state.snapshot() is not None


def test_a_snapshot_has_the_units_its_names_say() -> None:
    state = TelemetryState(7)
    state.fold("HEARTBEAT", HEARTBEAT, 1.0)
    state.fold("GLOBAL_POSITION_INT", POSITION, 2.0)
    state.fold("EXTENDED_SYS_STATE", {"landed_state": 2, "vtol_state": 0}, 2.5)
    state.fold("MISSION_CURRENT", {"seq": 3, "total": 41, "mission_id": 99}, 3.0)
    now = state.snapshot()
    assert now is not None
    assert (now.system_id, now.lat_deg, now.lon_deg) == (7, 47.397742, 8.545594)
    assert (now.relative_alt_m, now.altitude_amsl_m) == (60.0, 548.0)
    assert (now.velocity_north_mps, now.velocity_east_mps) == (1.5, -0.2)
    assert (now.armed, now.mode, now.landed_state) == (True, FlightMode.MISSION, LandedState.IN_AIR)
    assert (now.mission_current, now.mission_total, now.mission_id) == (3, 41, 99)
    assert (now.boot_ms, now.heard_at_s) == (12_000, 2.0)


def test_only_an_accepting_acknowledgement_of_a_mission_carries_its_checksum() -> None:
    state = TelemetryState(1)
    state.fold("MISSION_ACK", {"type": 1, "mission_type": 0, "opaque_id": 5}, 1.0)
    state.fold("MISSION_ACK", {"type": 0, "mission_type": 1, "opaque_id": 6}, 1.0)
    assert state.accepted_id is None
    state.fold("MISSION_ACK", {"type": 0, "mission_type": 0, "opaque_id": 7}, 1.0)
    assert state.accepted_id == 7


def test_an_autopilot_that_tells_no_total_and_no_checksum_is_understood() -> None:
    state = TelemetryState(1)
    state.fold("MISSION_CURRENT", {"seq": 3}, 1.0)
    assert (state.mission_current, state.mission_total, state.mission_id) == (3, None, 0)


def test_a_heartbeat_that_is_not_the_autopilots_changes_nothing() -> None:
    state = TelemetryState(1)
    ground_station = {"custom_mode": 0, "base_mode": 0, "type": 6, "autopilot": 8}
    state.fold("HEARTBEAT", ground_station, 0.0)
    assert not state.heard
    state.fold("HEARTBEAT", HEARTBEAT, 1.0)
    for foreign in (ground_station, HEARTBEAT | {"type": 18, "base_mode": 0}, HEARTBEAT | {"autopilot": 3}):
        state.fold("HEARTBEAT", foreign, 1.5)
    assert (state.autopilot, state.mode, state.armed) == (Autopilot.PX4, FlightMode.MISSION, True)


def test_another_autopilot_may_take_a_system_id_over_that_has_fallen_silent() -> None:
    state = TelemetryState(1)
    state.fold("HEARTBEAT", HEARTBEAT, 1.0)
    state.fold("HEARTBEAT", HEARTBEAT | {"autopilot": 3, "custom_mode": 3}, 8.0)
    assert (state.autopilot, state.mode) == (Autopilot.ARDUPILOT, FlightMode.MISSION)


@pytest.mark.parametrize(
    ("lat", "lon"),
    [(0, 0), (None, None), (float("nan"), 85455940), (0x7FFFFFFF, 0x7FFFFFFF), (910_000_000, 0)],
    ids=["zero", "null", "nan", "unknown", "off the globe"],
)
def test_a_position_that_means_none_is_no_position_and_everything_else_is_still_told(lat: Any, lon: Any) -> None:
    state = TelemetryState(1)
    state.fold("HEARTBEAT", HEARTBEAT, 1.0)
    state.fold("GLOBAL_POSITION_INT", {**POSITION, "lat": lat, "lon": lon}, 2.0)
    now = state.snapshot()
    assert now is not None
    assert (now.place_deg, now.lat_deg, now.lon_deg) == (None, None, None)
    assert (now.armed, now.mode, now.relative_alt_m) == (True, FlightMode.MISSION, 60.0)
    state.fold("HOME_POSITION", {"latitude": lat, "longitude": lon}, 2.0)
    assert state.home_deg is None


def test_without_a_3d_fix_it_does_not_know_where_it_is() -> None:
    state = TelemetryState(1)
    state.fold("HEARTBEAT", HEARTBEAT, 1.0)
    state.fold("GLOBAL_POSITION_INT", POSITION, 2.0)
    places = []
    for fix in (0, 1, 2, 3, 6):
        state.fold("GPS_RAW_INT", {"fix_type": fix, "satellites_visible": 9}, 2.0)
        now = state.snapshot()
        assert now is not None
        places.append(now.place_deg)
    assert places == [None, None, None, (47.397742, 8.545594), (47.397742, 8.545594)]


def test_a_place_on_the_equator_or_the_meridian_is_one() -> None:
    assert place_of(0, 85455940) == (0.0, 8.545594)
    assert place_of(473977420, 0) == (47.397742, 0.0)


def test_a_snapshot_is_made_once_for_each_message() -> None:
    state = TelemetryState(1)
    state.fold("HEARTBEAT", HEARTBEAT, 1.0)
    state.fold("GLOBAL_POSITION_INT", POSITION, 2.0)
    before = state.snapshot()
    assert state.snapshot() is before
    state.fold("MISSION_CURRENT", {"seq": 3, "total": 41, "mission_id": 99}, 3.0)
    after = state.snapshot()
    assert after is not before
    assert after is not None
    assert after.mission_current == 3


def told_everything() -> TelemetryState:
    """A vehicle on the ground that has told everything by second 10."""
    state = TelemetryState(1)
    state.fold("HEARTBEAT", {**HEARTBEAT, "base_mode": 29}, 9.0)
    state.fold("GLOBAL_POSITION_INT", {**POSITION, "relative_alt": 0, "time_boot_ms": 500_000}, 10.0)
    state.fold("GPS_RAW_INT", {"fix_type": 3, "satellites_visible": 12}, 10.0)
    state.fold("SYS_STATUS", {"battery_remaining": 40}, 10.0)
    state.fold("HOME_POSITION", {"latitude": 473977420, "longitude": 85455940, "altitude": 488_000}, 10.0)
    return state


def test_what_was_told_before_a_restart_counts_no_more() -> None:
    state = told_everything()
    state.fold("SYS_STATUS", {"battery_remaining": 100}, 38.0)
    state.fold("GPS_RAW_INT", {"fix_type": 3, "satellites_visible": 9}, 38.0)
    state.fold("GLOBAL_POSITION_INT", {**POSITION, "relative_alt": 0, "time_boot_ms": 5_000}, 40.0)
    assert (state.home_deg, state.home_amsl_m) == (None, None)
    assert (state.battery, state.gps_fix, state.satellites) == (1.0, 3, 9)
    assert state.place_deg is not None
    assert state.restarts == 1
    state.fold("HOME_POSITION", {"latitude": 473977421, "longitude": 85455940, "altitude": 488_000}, 41.0)
    state.fold("GLOBAL_POSITION_INT", {**POSITION, "relative_alt": 0, "time_boot_ms": 6_000}, 41.0)
    assert state.home_deg is not None


def test_a_vehicle_that_may_have_been_switched_off_has_to_tell_everything_again() -> None:
    state = told_everything()
    state.forget_before(30.0)
    assert (state.place_deg, state.home_deg, state.gps_fix, state.battery, state.battery_told) == (
        *(None, None, None, None),
        False,
    )
    now = state.snapshot()
    assert now is not None
    assert (now.place_deg, now.relative_alt_m) == (None, 0.0)
