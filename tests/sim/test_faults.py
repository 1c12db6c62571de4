"""sim.faults and sim.fault_schedule, struck in virtual time"""

from contextlib import suppress
from dataclasses import fields
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.sim import (
    FAULTS,
    ClockJump,
    CorruptUpload,
    Fault,
    Fleet,
    Freeze,
    GpsLoss,
    Impair,
    Impairments,
    LowBattery,
    Mode,
    ModeChange,
    MotorFailure,
    Mute,
    Reboot,
    RejectMission,
    Vehicle,
    VirtualClock,
    describe,
    fault_from,
    grid_of,
    parse_fault,
)
from skyfolio.sim.telemetry_messages import BUILDERS
from skyfolio.sim.wire import Decoder

if TYPE_CHECKING:
    from tests.sim.conftest import GroundStation, Items

HOME = (47.397742, 8.545594)


def flying(autopilot: str = "px4", **options: Any) -> tuple[Fleet, Vehicle]:
    """Return a fleet of one, 20 m up and holding."""
    fleet = Fleet(grid_of(1, *HOME, autopilot=autopilot), clock=VirtualClock(), **options)
    vehicle = fleet.vehicles[1]
    vehicle.autopilot.set_mode(Mode.HOLD if autopilot == "px4" else Mode.GUIDED)
    vehicle.autopilot.arm()
    vehicle.autopilot.takeoff(20.0)
    fleet.step_to(20.0)
    assert vehicle.position[2] == pytest.approx(20.0, abs=0.5)
    return fleet, vehicle


def listen(fleet: Fleet) -> list[tuple[float, str]]:
    """Return a list that will hold (fleet time, "datagram") of whatever the fleet sends."""
    heard: list[tuple[float, str]] = []
    fleet.attach(lambda _, system_id: heard.append((fleet.now_s, str(system_id))))
    return heard


def test_a_mute_for_a_while_is_silent_and_deaf_and_then_back() -> None:
    fleet, vehicle = flying()
    heard = listen(fleet)
    fleet.inject(Mute(1, for_s=5.0))
    fleet.step_to(24.9)
    assert not heard
    assert not vehicle.transmitting
    fleet.step_to(27.0)
    assert heard
    assert fleet.vehicles[1].transmitting
    assert [event.kind for event in fleet.truth.events[-3:]] == ["fault", "muted", "unmuted"]


def test_a_reboot_on_the_ground_starts_the_clock_again_and_keeps_plans_and_parameters(
    items: "Items", gcs: "GroundStation"
) -> None:
    fleet = Fleet(grid_of(1, *HOME), clock=VirtualClock())
    vehicle = fleet.vehicles[1]
    for message in (("mission_count", 1, 1, 1, 0), ("mission_item_int", 1, 1, *items.waypoint(80.0, 0.0))):
        vehicle.autopilot.handle(gcs.message(*message))
    vehicle.autopilot.parameters["NAV_ACC_RAD"] = 7.0
    fleet.step_to(30.0)
    heard = listen(fleet)
    vehicle.receive(gcs.command(dialect.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1.0), ("gcs", 0))
    fleet.step_to(30.2)
    heard.clear()
    fleet.step_to(32.9)
    assert not heard
    fleet.step_to(40.0)
    assert heard
    position: Any = vehicle.autopilot.telemetry.build(dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT)
    assert position.time_boot_ms < 7_500
    assert (len(vehicle.mission), vehicle.autopilot.parameters["NAV_ACC_RAD"]) == (1, 7.0)


def test_a_reboot_in_the_air_is_a_crash() -> None:
    fleet, vehicle = flying()
    fleet.inject(Reboot(1))
    fleet.step_to(30.0)
    assert not vehicle.alive
    assert fleet.truth.happened("crashed")


def test_a_frozen_vehicle_goes_on_as_its_motors_were_and_thaws() -> None:
    fleet, vehicle = flying()
    vehicle.autopilot.reposition(500.0, 0.0, None, 5.0)
    fleet.step_to(30.0)
    before = vehicle.autopilot.body.east_m
    vehicle.autopilot.reposition(0.0, 0.0, None, 5.0)
    fleet.inject(Freeze(1, for_s=4.0))
    fleet.step_to(34.0)
    assert vehicle.autopilot.body.east_m == pytest.approx(before + 20.0, abs=0.5)
    fleet.step_to(60.0)
    assert vehicle.autopilot.body.east_m < before


def test_a_vehicle_that_hung_for_8_s_answers_what_was_sent_and_misses_no_ground_station(gcs: "GroundStation") -> None:
    fleet, vehicle = flying("ardupilot")
    vehicle.autopilot.parameters["FS_GCS_ENABLE"] = 1
    vehicle.autopilot.parameters["SYSID_MYGCS"] = 245
    heard: list[Any] = []
    decoder = Decoder()
    send = fleet.attach(lambda data, _: heard.extend(decoder.decode(data)))
    send(gcs.frame("heartbeat", 6, 8, 0, 0, 4, 3), 1)
    before_ms = vehicle.autopilot.clock.boot_ms
    fleet.inject(Freeze(1, for_s=8.0))
    fleet.step_to(24.0)
    send(gcs.frame("command_long", 1, 1, 512, 0, 148.0, *[0.0] * 6), 1)
    fleet.step_to(27.9)
    assert not heard
    fleet.step_to(28.5)
    assert "AUTOPILOT_VERSION" in [message.get_type() for message in heard]
    assert vehicle.mode.name == "GUIDED"
    assert not vehicle.autopilot.failsafes.active
    assert vehicle.autopilot.clock.boot_ms - before_ms == pytest.approx(500, abs=60)


def test_a_vehicle_frozen_while_it_lands_softly_has_landed_not_crashed() -> None:
    fleet, vehicle = flying()
    vehicle.autopilot.set_mode(Mode.LAND)
    fleet.step_to(25.0)
    assert -1.5 <= vehicle.autopilot.body.up_mps < 0
    fleet.inject(Freeze(1, for_s=60.0))
    fleet.step_to(100.0)
    assert fleet.truth.happened("landed")
    assert not fleet.truth.happened("crashed")
    assert not vehicle.armed


def test_a_low_battery_acts_as_its_parameter_says() -> None:
    fleet, vehicle = flying()
    vehicle.autopilot.parameters["COM_LOW_BAT_ACT"] = 3
    fleet.inject(LowBattery(1, share=0.06))
    fleet.step_to(24.9)
    assert vehicle.mode.name == "HOLD"
    fleet.step_to(25.2)
    assert vehicle.mode.name == "RTL"
    fleet.inject(LowBattery(1, share=0.04))
    fleet.step_to(26.0)
    assert vehicle.mode.name == "LAND"
    causes = [(event.detail["cause"], event.detail["action"]) for event in fleet.truth.happened("failsafe")]
    assert causes == [("battery", "HOLD"), ("battery", "RETURN"), ("battery", "LAND")]


def test_an_empty_battery_lets_it_fall() -> None:
    fleet, vehicle = flying()
    fleet.inject(LowBattery(1, share=0.0))
    fleet.step_to(25.0)
    assert not vehicle.alive


@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_without_satellites_it_reports_it_lands_and_drifts(autopilot: str) -> None:
    fleet, vehicle = flying(autopilot)
    fleet.inject(GpsLoss(1))
    fleet.step_to(24.0)
    gps: Any = vehicle.autopilot.telemetry.build(dialect.MAVLINK_MSG_ID_GPS_RAW_INT)
    assert (gps.fix_type, gps.satellites_visible) == ((0, 255) if autopilot == "px4" else (1, 3))
    assert vehicle.mode.name == ("HOLD" if autopilot == "px4" else "GUIDED")
    fleet.step_to(32.0)
    assert vehicle.mode.name == "LAND"
    assert not vehicle.autopilot.set_mode(Mode.HOLD)
    fleet.step_to(80.0)
    assert not vehicle.armed
    assert not vehicle.autopilot.arm()
    assert 1.0 < vehicle.autopilot.body.distance_to(0.0, 0.0) < 20.0


def test_a_vehicle_with_a_failed_motor_reports_it_and_falls() -> None:
    fleet, vehicle = flying()
    fleet.inject(MotorFailure(1))
    fleet.step_to(24.0)
    assert not vehicle.alive
    assert vehicle.transmitting
    assert [event.kind for event in fleet.truth.events[-3:]] == ["fault", "motor_failed", "crashed"]


@pytest.mark.parametrize(
    ("autopilot", "texts"),
    [
        ("px4", ["Landing detected\t", "Disarmed by landing\t"]),
        (
            "ardupilot",
            ["Potential Thrust Loss (1)", "Crash: Disarming: AngErr=90>30, Accel=0.0<3.0", "Disarming motors"],
        ),
    ],
)
def test_a_vehicle_without_a_motor_falls_armed_and_disarms_on_the_ground(autopilot: str, texts: list[str]) -> None:
    fleet, vehicle = flying(autopilot)
    heard: list[Any] = []
    decoder = Decoder()
    fleet.attach(lambda data, _: heard.extend(decoder.decode(data)))
    fleet.inject(MotorFailure(1))
    fleet.step_to(21.0)
    beat: Any = vehicle.autopilot.telemetry.build(dialect.MAVLINK_MSG_ID_HEARTBEAT)
    state: Any = vehicle.autopilot.telemetry.build(dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE)
    assert (beat.base_mode & 128, beat.system_status) == (128, 4)
    assert state.landed_state == dialect.MAV_LANDED_STATE_IN_AIR
    fleet.step_to(30.0)
    assert not vehicle.armed
    assert [message.text for message in heard if message.get_type() == "STATUSTEXT"] == texts


def test_a_human_takes_over_and_the_vehicle_stays() -> None:
    fleet, vehicle = flying()
    fleet.inject(ModeChange(1))
    fleet.step_to(25.0)
    beat: Any = vehicle.autopilot.telemetry.build(dialect.MAVLINK_MSG_ID_HEARTBEAT)
    assert beat.custom_mode == 3 << 16
    assert not beat.base_mode & dialect.MAV_MODE_FLAG_AUTO_ENABLED
    assert vehicle.autopilot.body.up_m == pytest.approx(20.0, abs=0.1)


@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_a_rejected_mission_is_refused_at_its_end_once(autopilot: str, items: "Items", gcs: "GroundStation") -> None:
    fleet, vehicle = flying(autopilot)
    fleet.inject(RejectMission(1))
    results = []
    for _ in range(2):
        items.seq = 0
        vehicle.autopilot.handle(gcs.message("mission_count", 1, 1, 1, 0))
        answers = vehicle.autopilot.handle(gcs.message("mission_item_int", 1, 1, *items.waypoint(80.0, 0.0)))
        results.append(answers[-1].type)
    assert results == [dialect.MAV_MISSION_ERROR, dialect.MAV_MISSION_ACCEPTED]
    assert len(fleet.truth.happened("mission_accepted")) == 1


@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_a_corrupted_upload_is_acknowledged_and_only_a_read_back_shows_it(
    autopilot: str, items: "Items", gcs: "GroundStation"
) -> None:
    fleet, vehicle = flying(autopilot)
    fleet.inject(CorruptUpload(1))
    sent = [items.waypoint(40.0, 0.0), items.waypoint(80.0, 0.0)]
    vehicle.autopilot.handle(gcs.message("mission_count", 1, 1, 2, 0))
    for item in sent:
        answers = vehicle.autopilot.handle(gcs.message("mission_item_int", 1, 1, *item))
    assert answers[-1].type == dialect.MAV_MISSION_ACCEPTED
    assert [item.x for item in vehicle.autopilot.missions.mission.items] == [sent[0][9], sent[1][9] + 2000]


def test_a_clock_jumps_back_without_a_reboot() -> None:
    fleet, vehicle = flying()
    fleet.inject(ClockJump(1, seconds=-15.0))
    position: Any = vehicle.autopilot.telemetry.build(dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT)
    assert position.time_boot_ms == pytest.approx(65_000, abs=100)


def test_a_cut_link_comes_back_after_its_time() -> None:
    fleet, vehicle = flying()
    slow = Impairments(latency_s=0.2)
    fleet.impair(up=slow, down=slow)
    heard = listen(fleet)
    fleet.inject(Impair(1, down=Impairments(cut=True), for_s=5.0))
    fleet.step_to(24.9)
    assert not heard
    fleet.step_to(27.0)
    assert heard
    assert vehicle.radio.down.impairments == slow


def test_a_fault_can_wait_for_a_slot_of_the_plan() -> None:
    fleet, vehicle = flying()
    fleet.inject(Mute(1), at_slot=3)
    fleet.step_to(30.0)
    fleet.start_slots(5.0)
    fleet.step_to(44.9)
    assert vehicle.transmitting
    fleet.step_to(45.1)
    assert fleet.truth.happened("muted")[0].t_s == pytest.approx(45.0)
    with pytest.raises(ValueError, match="one of them"):
        fleet.inject(Mute(1), at_slot=3, at_s=3.0)


@pytest.mark.parametrize(
    ("text", "fault", "at_s", "at_slot"),
    [
        ("mute:3@60,for_s=20", Mute(3, for_s=20), 60.0, None),
        ("low-battery:1@slot=4,share=0.05", LowBattery(1, share=0.05), None, 4),
        ("mode-change:2,mode=LAND", ModeChange(2, mode="LAND"), None, None),
        ("clock-jump:2@1.5,seconds=-60", ClockJump(2, seconds=-60), 1.5, None),
    ],
)
def test_faults_are_written_as_kind_vehicle_time_and_knobs(
    text: str, fault: Fault, at_s: float | None, at_slot: int | None
) -> None:
    assert parse_fault(text) == (fault, at_s, at_slot)
    assert fault_from(describe(fault)) == fault


@pytest.mark.parametrize(
    ("data", "words"),
    [
        ({"kind": "sleep", "system_id": 1}, "kind must be one of kill, mute"),
        ({"kind": "kill"}, "system_id: kill needs it"),
        ({"kind": "kill", "system_id": 0}, "system_id must be a whole number between 1 and 254, got 0"),
        ({"kind": "mute", "system_id": 1, "loud": 1}, "loud: mute has no such field"),
        ({"kind": "mute", "system_id": 1, "for_s": -2}, "for_s must be a number of seconds above 0"),
        ({"kind": "low_battery", "system_id": 1, "share": 2.0}, "share must be between 0 and 1"),
        ({"kind": "mode_change", "system_id": 1, "mode": "FLIP"}, "mode must be one of TAKEOFF"),
        ({"kind": "impair", "system_id": 1, "up": {"noise": 1}}, "noise: a link has no such impairment"),
        ({"kind": "impair", "system_id": 1, "up": {"loss": "much"}}, "loss must be a number"),
        (
            {"kind": "clock_jump", "system_id": 1, "seconds": 1e308},
            "seconds must be between -1000000 and 1000000",
        ),
        (
            {"kind": "mute", "system_id": 1, "for_s": 1e308},
            "for_s must be .* above 0 and at most 1000000",
        ),
        ({"kind": "reboot", "system_id": 1, "for_s": None}, "for_s must be a number of seconds"),
        ({"kind": "corrupt_upload", "system_id": 1, "uploads": 10**30}, "uploads must be a whole number between 1 and"),
        ({"kind": "low_battery", "system_id": 1, "share": True}, "share must be a number, got True"),
        ({"kind": "impair", "system_id": 1, "down": {"bandwidth_bps": 1e-300}}, "bandwidth_bps must be between 1 and"),
        ({"kind": "impair", "system_id": 1, "up": {"latency_s": 1e308}}, "latency_s must be between 0 and 3600"),
        ({"kind": "impair", "system_id": 1, "up": 3}, "up must be the impairments of a link, got 3"),
    ],
)
def test_an_impossible_fault_is_refused_naming_the_field(data: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        fault_from(data)


@pytest.mark.parametrize("text", ["kill", "kill:x", "mute:1@", "mute:1,for_s"])
def test_a_fault_that_cannot_be_read_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="must look like"):
        parse_fault(text)


@pytest.mark.parametrize(("when", "name"), [({"at_s": 1e308}, "at_s"), ({"at_slot": 10**9}, "at_slot")])
def test_a_fault_at_a_moment_that_never_comes_is_refused(when: dict[str, Any], name: str) -> None:
    with pytest.raises(ValueError, match=name):
        Fleet(grid_of(1, *HOME), clock=VirtualClock()).inject(Mute(1), **when)


_ANY = st.one_of(
    st.none(), st.booleans(), st.floats(), st.integers(), st.sampled_from([1e6, -1e6, 1e308, 0, 1, "POSITION", "LAND"])
)
_LINKS = st.dictionaries(st.sampled_from([field.name for field in fields(Impairments)]), _ANY, max_size=4)


@st.composite
def _asked_for(draw: st.DrawFn) -> dict[str, Any]:
    """Return a fault as a stranger might write it."""
    kind = draw(st.sampled_from(sorted(FAULTS)))
    knobs = [field.name for field in fields(FAULTS[kind]) if field.name != "system_id"]
    chosen = draw(st.lists(st.sampled_from(knobs), unique=True)) if knobs else []
    return {"kind": kind, "system_id": 1} | {
        knob: draw(st.one_of(_ANY, _LINKS) if knob in ("up", "down") else _ANY) for knob in chosen
    }


@settings(max_examples=120)
@given(flavour=st.sampled_from(["px4", "ardupilot"]), asked=st.lists(_asked_for(), min_size=1, max_size=4))
def test_the_fleet_survives_whatever_fault_is_accepted(flavour: str, asked: list[dict[str, Any]]) -> None:
    fleet, vehicle = flying(flavour)
    heard = listen(fleet)
    for data in asked:
        with suppress(ValueError):
            fleet.inject(fault_from(data))
        fleet.step_to(fleet.now_s + 2.0)
        for message_id in BUILDERS:
            message = vehicle.autopilot.telemetry.build(message_id)
            assert message is None or message.pack(dialect.MAVLink(None, srcSystem=1, srcComponent=1))
    fleet.step_to(fleet.now_s + 5.0)
    assert fleet.truth.happened("fault") or heard


def test_every_kind_of_fault_is_described() -> None:
    assert all(kind.__doc__ for kind in FAULTS.values())
    assert {describe(kind(1))["kind"] for kind in FAULTS.values()} == set(FAULTS)


def test_failures_are_injected_by_mavlink_once_px4_allows_it(gcs: "GroundStation") -> None:
    def inject(unit: int, kind: int) -> int:
        (ack,) = vehicle.autopilot.handle(gcs.command(dialect.MAV_CMD_INJECT_FAILURE, float(unit), float(kind)))[:1]
        return int(ack.result)

    fleet, vehicle = flying()
    off = dialect.FAILURE_TYPE_OFF
    assert inject(dialect.FAILURE_UNIT_SENSOR_GPS, off) == dialect.MAV_RESULT_DENIED
    vehicle.autopilot.parameters["SYS_FAILURE_EN"] = 1
    assert inject(dialect.FAILURE_UNIT_SENSOR_GPS, off) == dialect.MAV_RESULT_ACCEPTED
    assert not vehicle.autopilot.satellites
    assert inject(dialect.FAILURE_UNIT_SENSOR_GPS, dialect.FAILURE_TYPE_OK) == dialect.MAV_RESULT_ACCEPTED
    assert vehicle.autopilot.dynamics.satellites
    assert inject(dialect.FAILURE_UNIT_SENSOR_VIO, off) == dialect.MAV_RESULT_UNSUPPORTED
    assert inject(dialect.FAILURE_UNIT_SYSTEM_MOTOR, off) == dialect.MAV_RESULT_ACCEPTED
    fleet.step_to(25.0)
    assert not vehicle.alive


@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_a_message_that_is_withheld_is_neither_streamed_nor_answered_until_that_is_over(autopilot: str) -> None:
    fleet, vehicle = flying(autopilot)
    names: list[str] = []
    decoder = Decoder()
    fleet.attach(lambda data, _system_id: names.extend(message.get_type() for message in decoder.decode(data)))
    vehicle.autopilot.telemetry.set_interval(dialect.MAVLINK_MSG_ID_MISSION_CURRENT, 0.2)
    fleet.inject(fault_from({"kind": "withhold", "system_id": 1, "message": "MISSION_CURRENT", "for_s": 5.0}))
    fleet.step_to(fleet.now_s + 4.0)
    assert "HEARTBEAT" in names
    assert "MISSION_CURRENT" not in names
    fleet.step_to(fleet.now_s + 2.0)
    assert "MISSION_CURRENT" in names


def test_only_a_message_that_there_is_can_be_withheld() -> None:
    with pytest.raises(ValueError, match="message must be the name of a MAVLink message, got 'MISSION'"):
        fault_from({"kind": "withhold", "system_id": 1, "message": "MISSION"})
