"""sim.autopilot and sim.command_table"""

from collections.abc import Callable
from math import isfinite
from typing import TYPE_CHECKING

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.sim.flavours import ARDUPILOT, PX4
from skyfolio.sim.modes import Mode, ardupilot_base_mode, px4_base_mode

if TYPE_CHECKING:
    from tests.sim.conftest import Bench, Items

NAN = float("nan")
ACCEPTED, REJECTED, DENIED, UNSUPPORTED, FAILED = 0, 1, 2, 3, 4
TAKEOFF, HOLD, MISSION, RTL, LAND = 2, 3, 4, 5, 6


def test_it_takes_off_to_the_takeoff_altitude_and_holds(bench: "Bench") -> None:
    bench.take_off(20.0)
    assert bench.autopilot.mode is Mode.HOLD
    assert bench.kinds()[:4] == ["armed", "mode", "takeoff", "mode"]
    bench.fly(30.0)
    assert bench.autopilot.body.up_m == pytest.approx(20.0, abs=0.05)


def test_an_altitude_in_the_takeoff_command_is_above_sea_level(bench: "Bench") -> None:
    bench.command(400, 1.0)
    bench.command(22, NAN, NAN, NAN, NAN, NAN, NAN, 488.0 + 12.0)
    bench.fly(20.0)
    assert bench.autopilot.body.up_m == pytest.approx(12.0, abs=0.05)


def test_it_stays_on_the_ground_until_it_is_armed(bench: "Bench") -> None:
    bench.command(22, NAN, NAN, NAN, NAN, NAN, NAN, NAN)
    bench.fly(5.0)
    assert bench.autopilot.body.on_ground
    bench.command(400, 1.0)
    bench.fly(5.0)
    assert not bench.autopilot.body.on_ground


def test_disarming_in_the_air_is_denied_unless_forced_and_then_it_crashes(airborne: "Bench") -> None:
    assert airborne.command(400, 0.0) == REJECTED
    assert airborne.command(400, 0.0, 21196.0) == ACCEPTED
    airborne.fly_until(lambda: airborne.autopilot.dynamics.crashed, within_s=4.0)
    assert airborne.command(400, 1.0) == REJECTED


def test_it_lands_in_place_and_disarms_by_itself(airborne: "Bench") -> None:
    assert airborne.command(21, 0.0, 0.0, 0.0, NAN) == ACCEPTED
    airborne.fly_until(lambda: airborne.autopilot.body.on_ground)
    assert "disarmed" not in airborne.kinds()
    airborne.fly(2.2)
    assert not airborne.autopilot.armed
    assert airborne.kinds()[-3:] == ["landed", "disarmed", "mode"]
    assert airborne.autopilot.mode is Mode.HOLD


def test_a_return_climbs_flies_home_and_lands(airborne: "Bench") -> None:
    lat, lon = airborne.autopilot.frame.to_geodetic(60.0, 60.0)
    airborne.autopilot.reposition(*airborne.autopilot.frame.to_local(lat, lon), None, 8.0)
    airborne.fly(30.0)
    assert airborne.set_mode(RTL) == ACCEPTED
    highest = 0.0
    while airborne.autopilot.armed:
        airborne.fly(0.05)
        highest = max(highest, airborne.autopilot.body.up_m)
    assert highest == pytest.approx(30.0, abs=0.9)
    assert airborne.autopilot.body.distance_to(0.0, 0.0) < 0.1


def test_it_flies_again_after_it_has_landed(airborne: "Bench") -> None:
    airborne.set_mode(LAND)
    airborne.fly_until(lambda: not airborne.autopilot.armed)
    airborne.take_off(10.0)
    assert airborne.autopilot.mode is Mode.HOLD


def test_home_is_where_it_was_armed_last(airborne: "Bench") -> None:
    airborne.autopilot.reposition(40.0, 0.0, None, 8.0)
    airborne.fly(20.0)
    airborne.set_mode(LAND)
    airborne.fly_until(lambda: not airborne.autopilot.armed)
    airborne.command(400, 1.0)
    assert airborne.autopilot.home_m == pytest.approx((40.0, 0.0), abs=0.1)


def test_holding_brakes_to_a_stop_without_turning_back(airborne: "Bench") -> None:
    airborne.autopilot.reposition(300.0, 0.0, None, 10.0)
    airborne.fly(8.0)
    airborne.set_mode(HOLD)
    furthest = 0.0
    for _ in range(300):
        airborne.fly(0.05)
        furthest = max(furthest, airborne.autopilot.body.east_m)
    assert airborne.autopilot.body.east_m == pytest.approx(furthest, abs=0.05)


def test_a_reposition_goes_there_at_the_given_height(airborne: "Bench") -> None:
    lat, lon = airborne.autopilot.frame.to_geodetic(30.0, 40.0)
    values = (1, 1, dialect.MAV_FRAME_GLOBAL_INT, 192, 0, 0, -1.0, 1.0, 0.0, NAN, round(lat * 1e7), round(lon * 1e7))
    (ack,) = airborne.ask("command_int", *values, 488.0 + 25.0)
    assert ack.result == ACCEPTED
    airborne.fly(30.0)
    assert airborne.autopilot.body.distance_to(30.0, 40.0) < 0.1
    assert airborne.autopilot.body.up_m == pytest.approx(25.0, abs=0.1)


def test_the_mission_mode_is_refused_without_a_mission_once_it_is_armed(bench: "Bench") -> None:
    assert bench.set_mode(MISSION) == ACCEPTED
    assert bench.command(400, 1.0) == REJECTED
    assert bench.command(300) == DENIED
    assert bench.set_mode(HOLD) == ACCEPTED
    assert bench.command(400, 1.0) == ACCEPTED
    assert bench.set_mode(MISSION) == REJECTED
    assert bench.autopilot.mode is Mode.HOLD


def test_mission_start_arms_and_starts_at_the_given_item(bench: "Bench", items: "Items") -> None:
    bench.upload(items.add(22, current=1.0), items.waypoint(20.0, 0.0), items.waypoint(40.0, 0.0))
    assert bench.command(300, 1.0, 2.0) == ACCEPTED
    assert (bench.autopilot.armed, bench.autopilot.mode, bench.autopilot.runner.index) == (True, Mode.MISSION, 1)


def test_a_speed_command_changes_the_speed_in_the_mission(airborne: "Bench", items: "Items") -> None:
    airborne.upload(items.waypoint(300.0, 0.0, current=1.0))
    airborne.set_mode(MISSION)
    assert airborne.command(178, 1.0, 9.0, -1.0) == ACCEPTED
    airborne.fly(8.0)
    assert airborne.autopilot.body.ground_speed_mps == pytest.approx(9.0, abs=0.05)
    assert airborne.command(178, 1.0, -2.0) == ACCEPTED
    airborne.fly(5.0)
    assert airborne.autopilot.body.ground_speed_mps == pytest.approx(5.0, abs=0.05)
    assert airborne.command(178, 1.0, NAN) == DENIED


def test_a_speed_ordered_while_a_px4_returns_is_obeyed_until_its_next_mode(airborne: "Bench") -> None:
    airborne.autopilot.reposition(150.0, 0.0, 35.0, 10.0)
    airborne.fly(40.0)
    assert airborne.set_mode(RTL) == ACCEPTED
    assert airborne.command(178, 1.0, 0.6, -1.0) == ACCEPTED
    airborne.fly(20.0)
    assert airborne.autopilot.body.ground_speed_mps == pytest.approx(0.6, abs=0.05)
    airborne.set_mode(HOLD)
    airborne.set_mode(RTL)
    airborne.fly(5.0)
    assert airborne.autopilot.body.ground_speed_mps == pytest.approx(5.0, abs=0.1)


def test_a_speed_ordered_in_a_mission_is_forgotten_with_it_and_the_items_own_counts_again(
    airborne: "Bench", items: "Items"
) -> None:
    airborne.upload(items.speed(3.0, current=1.0), items.waypoint(600.0, 0.0))
    airborne.set_mode(MISSION)
    airborne.fly(2.0)
    airborne.command(178, 1.0, 8.0, -1.0)
    airborne.fly(8.0)
    assert airborne.autopilot.body.ground_speed_mps == pytest.approx(8.0, abs=0.1)
    airborne.set_mode(HOLD)
    airborne.fly(5.0)
    airborne.set_mode(MISSION)
    airborne.fly(8.0)
    assert airborne.autopilot.body.ground_speed_mps == pytest.approx(3.0, abs=0.1)


def test_a_px4_that_has_landed_is_in_the_last_mode_it_can_be_armed_in_and_home_is_where_it_stands(
    airborne: "Bench", items: "Items"
) -> None:
    airborne.upload(items.waypoint(40.0, 0.0, current=1.0))
    airborne.set_mode(MISSION)
    airborne.fly(4.0)
    airborne.set_mode(LAND)
    airborne.fly_until(lambda: not airborne.autopilot.armed)
    assert airborne.autopilot.mode is Mode.MISSION
    body = airborne.autopilot.body
    assert airborne.autopilot.home_m == (body.east_m, body.north_m)


def test_a_px4_sends_the_recorded_texts_on_its_way_through_a_flight(airborne: "Bench") -> None:
    airborne.command(21)
    airborne.fly_until(lambda: not airborne.autopilot.armed)
    airborne.fly(0.1)
    assert [m.text for m in airborne.sent if m.get_type() == "STATUSTEXT"] == [
        "Armed by external command\t",
        "Takeoff detected\t",
        "Landing at current position\t",
        "Landing detected\t",
        "Disarmed by landing\t",
    ]


@pytest.mark.parametrize("command", [42, 2000, 31000])
def test_a_command_it_does_not_know_is_unsupported(bench: "Bench", command: int) -> None:
    assert bench.command(command) == UNSUPPORTED


@pytest.mark.parametrize("mode", [(1.0, 4.0, 1.0), (1.0, 1.0, 0.0), (1.0, 4.0, NAN), (0.0, 4.0, 3.0)])
def test_a_mode_it_does_not_have_is_unsupported(bench: "Bench", mode: tuple[float, ...]) -> None:
    assert bench.command(176, *mode) == UNSUPPORTED


def test_messages_for_other_systems_are_ignored(bench: "Bench") -> None:
    assert bench.autopilot.handle(bench.gcs.command(400, 1.0, system_id=2)) == []
    assert not bench.autopilot.armed
    assert bench.ask("mission_count", 2, 1, 3, 0) == []
    assert bench.ask("mission_count", 1, 191, 3, 0) == []


def test_a_request_brings_the_message_and_its_acknowledgement_in_the_autopilots_order(
    bench: "Bench", copter: "Bench"
) -> None:
    version, ack = bench.autopilot.handle(bench.gcs.command(512, 148.0))
    assert (ack.result, version.get_type()) == (ACCEPTED, "AUTOPILOT_VERSION")
    ack, version = copter.autopilot.handle(copter.gcs.command(512, 148.0))
    assert (ack.result, version.get_type()) == (ACCEPTED, "AUTOPILOT_VERSION")
    assert bench.command(512, 9999.0) == DENIED


def test_a_px4_neither_sends_mission_current_on_request_nor_sets_its_rate(bench: "Bench") -> None:
    assert bench.command(512, 42.0) == DENIED
    assert bench.command(511, 42.0, 1e6) == FAILED


def test_a_ping_is_answered_to_its_sender(bench: "Bench") -> None:
    (pong,) = bench.ask("ping", 123, 7, 0, 0)
    assert (pong.time_usec, pong.seq, pong.target_system) == (123, 7, 245)


def test_modes_are_written_as_each_autopilot_writes_them() -> None:
    assert PX4.custom_modes[Mode.MISSION] == 0x04040000
    assert ARDUPILOT.custom_modes[Mode.MISSION] == 3
    assert [px4_base_mode(Mode.MISSION, armed=armed) for armed in (False, True)] == [29, 157]
    assert px4_base_mode(Mode.GUIDED, armed=False) == 17
    assert [ardupilot_base_mode(mode, armed=False) for mode in (Mode.STABILIZE, Mode.MISSION)] == [81, 89]
    assert ardupilot_base_mode(Mode.RTL, armed=True) == 217


@pytest.mark.parametrize("flavour", ["px4", "ardupilot"])
@given(
    orders=st.lists(
        st.tuples(
            st.sampled_from([16, 20, 21, 22, 176, 178, 192, 193, 224, 246, 300, 400, 420, 511, 512]),
            st.lists(
                st.one_of(st.floats(width=32), st.integers(-3, 300).map(float), st.just(21196.0)),
                min_size=7,
                max_size=7,
            ),
        ),
        max_size=12,
    )
)
def test_no_order_of_commands_with_any_numbers_breaks_it(
    new_bench: Callable[..., "Bench"], flavour: str, orders: list[tuple[int, list[float]]]
) -> None:
    bench = new_bench(flavour=flavour)
    mav = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
    for command, params in orders:
        for answer in bench.autopilot.handle(bench.gcs.command(command, *params)):
            answer.pack(mav)
        bench.fly(1.0)
    assert all(isfinite(number) for number in bench.autopilot.body)
    for message in bench.sent:
        message.pack(mav)
