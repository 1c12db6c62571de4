"""The failure classifier as stories in virtual time."""

from __future__ import annotations

import random
from itertools import pairwise
from math import inf
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skyfolio.mavlink_bridge.autopilots import FlightMode
from skyfolio.mavlink_bridge.classifier import Classifier
from skyfolio.mavlink_bridge.conditions import Change, Condition, Lasting, Timing

PX4_MISSION, PX4_LAND, PX4_RETURN, PX4_POSITION = (4 << 16 | 4 << 24, 4 << 16 | 6 << 24, 4 << 16 | 5 << 24, 3 << 16)
PX4_HOLD, PX4_TAKEOFF, PX4_OFFBOARD = (4 << 16 | 3 << 24, 4 << 16 | 2 << 24, 6 << 16)
COPTER_AUTO, COPTER_RTL, COPTER_STABILIZE, COPTER_GUIDED = 3, 6, 0, 4
ARMED, DISARMED = 157, 29


class Story:
    """One flying UAV; each step is a second of its telemetry."""

    def __init__(self, *, autopilot: int = 12, mode: int = PX4_MISSION) -> None:
        self.classifier = Classifier()
        self.now_s = 0.0
        self.changes: list[Change] = []
        self.values: dict[str, Any] = {
            "autopilot": autopilot, "custom_mode": mode, "base_mode": ARMED, "system_status": 4, "relative_alt": 60_000,
            "vz": 0, "landed_state": 2, "battery_remaining": 90,
            "seq": 3, "total": 20, "mission_state": 3, "mission_id": 7,
        }  # fmt: skip
        self.boot_s = 0.0
        self.classifier.watch(1, 0.0)
        self.tell(2)

    def tell(self, seconds: float, **changes: Any) -> list[Condition]:
        """Heartbeats and the rest at 1 Hz for a while; the conditions it went through."""
        self.values |= changes
        first = len(self.changes)
        for _ in range(round(seconds)):
            for name in ("HEARTBEAT", "GLOBAL_POSITION_INT", "EXTENDED_SYS_STATE", "SYS_STATUS", "MISSION_CURRENT"):
                fields = self.values | {"time_boot_ms": round((self.now_s - self.boot_s) * 1000)}
                self.classifier.hear(1, 1, name, fields, self.now_s)
            self.silence(1)
        return [change.after for change in self.changes[first:]]

    def fall(self, seconds: float, **changes: Any) -> list[Condition]:
        """Positions at 5 Hz of a free fall, heartbeats at 1 Hz; on the ground it stays there."""
        self.values |= changes
        first, began_s, from_m = len(self.changes), self.now_s, self.values["relative_alt"]
        for tick in range(round(seconds * 5)):
            fell_s = self.now_s - began_s
            up = max(0, round(from_m - 4905 * fell_s**2))
            self.values |= {"relative_alt": up, "vz": round(981 * fell_s) if up else 0}
            names = ("HEARTBEAT", "EXTENDED_SYS_STATE") if tick % 5 == 0 else ()
            for name in (*names, "GLOBAL_POSITION_INT"):
                fields = self.values | {"time_boot_ms": round((self.now_s - self.boot_s) * 1000)}
                self.classifier.hear(1, 1, name, fields, self.now_s)
            self.silence(0.2)
        return [change.after for change in self.changes[first:]]

    def say(self, words: str, severity: int = 2) -> None:
        """A STATUSTEXT, by default MAV_SEVERITY_CRITICAL."""
        self.classifier.hear(1, 1, "STATUSTEXT", {"text": words, "severity": severity}, self.now_s)

    def order(self, mode: FlightMode, until_s: float | None = None) -> None:
        self.classifier.expect(1, frozenset({mode}), self.now_s, until_s)

    def silence(self, seconds: float, *, companion: bool = False) -> list[Condition]:
        """Nothing from the autopilot for a while."""
        first = len(self.changes)
        until_s = self.now_s + seconds
        while self.now_s < until_s - 1e-9:
            self.now_s = round(self.now_s + 0.1, 6)
            if companion and round(self.now_s * 10) % 10 == 0:
                self.classifier.hear(
                    1, 191, "HEARTBEAT", {"autopilot": 8, "custom_mode": 0, "base_mode": 0}, self.now_s
                )
            self.changes += self.classifier.poll(self.now_s)
        return [change.after for change in self.changes[first:]]

    @property
    def cause(self) -> str:
        return self.changes[-1].cause


def test_a_uav_that_tells_of_itself_is_live_and_nothing_changes() -> None:
    story = Story()
    assert story.tell(60) == []
    assert story.classifier.condition(1) is Condition.LIVE


def test_silence_is_stale_then_link_lost_and_back_before_it_counts_again() -> None:
    story = Story()
    assert story.silence(10) == [Condition.STALE, Condition.LINK_LOST]
    assert story.cause.startswith("silent for 5.5 s")
    assert story.tell(8) == [Condition.BACK, Condition.LIVE]


def test_a_ghost_with_a_living_companion_is_a_silent_autopilot_and_not_a_live_one() -> None:
    story = Story()
    assert story.silence(9, companion=True) == [Condition.STALE, Condition.AUTOPILOT_SILENT]
    assert "component 191" in story.cause
    assert story.silence(5) == [Condition.LINK_LOST]  # now the companion is gone too


def test_a_reboot_is_seen_by_the_boot_clock_and_passes() -> None:
    story = Story()
    story.tell(30)
    story.boot_s = story.now_s
    assert story.tell(14, mission_id=8) == [Condition.REBOOTED, Condition.LIVE]
    assert [change.flies_on for change in story.changes] == [False, False]


def test_a_uav_that_rebooted_in_the_air_may_prove_that_it_flies_its_mission_on() -> None:
    story = Story()
    story.tell(30)
    story.boot_s = story.now_s
    assert story.tell(14) == [Condition.REBOOTED, Condition.LIVE]
    assert story.changes[0].flies_on
    assert "flies its mission on" in story.changes[0].cause


def test_a_uav_that_reboots_on_the_ground_has_nothing_to_prove() -> None:
    story = Story()
    story.tell(5, base_mode=DISARMED, relative_alt=0)
    story.tell(1, base_mode=ARMED)
    story.boot_s = story.now_s
    assert story.tell(2) == [Condition.REBOOTED]
    assert not story.changes[-1].flies_on


def test_a_clock_that_jumps_ahead_is_no_reboot_and_no_loss() -> None:
    story = Story()
    story.boot_s -= 3600.0
    assert story.tell(10) == []


def test_our_own_clock_jumping_back_changes_nothing() -> None:
    story = Story()
    story.now_s -= 1.5
    story.boot_s -= 1.5
    assert story.tell(5) == []


def test_a_vehicle_whose_clock_is_set_back_was_not_restarted() -> None:
    story = Story()
    story.tell(60)
    story.boot_s += 10.0
    assert story.tell(10) == []


def test_how_one_flight_ended_is_history_when_the_next_begins() -> None:
    story = Story()
    assert story.fall(10, base_mode=DISARMED) == [Condition.CRASHED]
    assert story.tell(30) == []
    assert story.tell(5, base_mode=ARMED) == [Condition.LIVE]
    assert story.tell(5, relative_alt=60_000) == []
    assert story.fall(10, base_mode=DISARMED) == [Condition.CRASHED]


def test_a_failsafe_is_over_when_the_next_flight_begins() -> None:
    story = Story()
    assert story.tell(3, custom_mode=PX4_LAND, system_status=5) == [Condition.FAILSAFE]
    assert story.tell(2, relative_alt=1_000) == []
    assert story.tell(2, base_mode=DISARMED, relative_alt=0) == [Condition.LANDED]
    assert story.tell(1, base_mode=ARMED, custom_mode=PX4_MISSION) == [Condition.LIVE]


@pytest.mark.parametrize(("autopilot", "mode"), [(12, PX4_POSITION), (3, COPTER_STABILIZE)])
def test_a_mode_nobody_commanded_is_a_human(autopilot: int, mode: int) -> None:
    story = Story(autopilot=autopilot, mode=PX4_MISSION if autopilot == 12 else COPTER_AUTO)
    assert story.tell(4, custom_mode=mode) == [Condition.HUMAN]
    assert "not commanded" in story.cause
    back = PX4_MISSION if autopilot == 12 else COPTER_AUTO
    assert story.tell(2, custom_mode=back) == []  # not at once
    assert story.tell(3) == [Condition.LIVE]


RETURNS = pytest.mark.parametrize(
    ("autopilot", "flies", "returns"), [(12, PX4_MISSION, PX4_RETURN), (3, COPTER_AUTO, COPTER_RTL)]
)


@RETURNS
def test_a_return_that_no_failsafe_explains_is_a_human(autopilot: int, flies: int, returns: int) -> None:
    story = Story(autopilot=autopilot, mode=flies)
    story.say("RTL: start return at 645 m", severity=6)
    assert story.tell(30, custom_mode=returns) == [Condition.HUMAN]
    assert story.tell(10, system_status=5) == []  # a failsafe of later changes nothing


@RETURNS
@pytest.mark.parametrize("sign", ["status", "text", "battery"])
def test_a_return_that_a_failsafe_explains_is_one_and_stays_one(
    autopilot: int, flies: int, returns: int, sign: str
) -> None:
    story = Story(autopilot=autopilot, mode=flies)
    if sign == "text":
        story.say("Max Alt fence breached", severity=5)
    changes = {"status": {"system_status": 5}, "text": {}, "battery": {"battery_remaining": 15}}[sign]
    assert story.tell(4, custom_mode=returns, **changes)[-1] is Condition.FAILSAFE
    assert story.tell(10, system_status=4) == []


def test_setpoints_that_end_and_send_a_px4_home_are_its_failsafe() -> None:
    story = Story(mode=PX4_OFFBOARD)
    assert story.tell(5, custom_mode=PX4_RETURN, system_status=5) == [Condition.FAILSAFE]


@pytest.mark.parametrize(("autopilot", "mode"), [(12, PX4_MISSION), (12, PX4_OFFBOARD), (3, COPTER_AUTO)])
def test_a_failsafe_that_continues_the_mission_is_a_warning_and_no_failsafe(autopilot: int, mode: int) -> None:
    story = Story(autopilot=autopilot, mode=mode)
    assert story.classifier.warning(1) is None
    story.say("GCS Failsafe - Continuing Auto Mode", severity=4)
    assert story.tell(30, system_status=5) == []
    assert "said 'GCS Failsafe - Continuing Auto Mode'" in str(story.classifier.warning(1))
    story.tell(2, system_status=4)
    assert story.classifier.warning(1) is None


@pytest.mark.parametrize("status", [6, 8])
def test_an_emergency_is_a_failsafe_in_any_mode(status: int) -> None:
    assert Story().tell(3, system_status=status) == [Condition.FAILSAFE]


def test_what_explains_a_failsafe_is_what_was_said_about_it() -> None:
    story = Story()
    story.say("Mission finished", severity=6)
    story.say("Battery is getting low\t")
    story.say("Low battery\t")
    story.tell(2)
    story.say("Failsafe activated: entering Hold for 5 seconds\t")
    story.say("System does not support shutdown\t")
    assert story.tell(3, custom_mode=PX4_HOLD, system_status=5, battery_remaining=6) == [Condition.FAILSAFE]
    said = "'Low battery', 'Failsafe activated: entering Hold for 5 seconds'"
    assert story.cause == f"in mode 'hold', system status 5, said {said}, 6% of charge left"


def test_a_text_of_several_messages_is_read_as_one() -> None:
    story = Story()
    for chunk, text in enumerate(["Failsafe activated: " + 30 * "x", "and so on"]):
        fields = {"text": text, "severity": 2, "id": 4, "chunk_seq": chunk}
        story.classifier.hear(1, 1, "STATUSTEXT", fields, story.now_s)
    story.tell(3, custom_mode=PX4_LAND, system_status=5)
    assert "xxand so on'" in story.cause


@pytest.mark.parametrize(
    ("autopilot", "flies", "hold"),
    [
        (12, PX4_MISSION, PX4_HOLD),
        (12, PX4_OFFBOARD, PX4_HOLD),
        (12, PX4_POSITION, PX4_HOLD),
        (3, COPTER_AUTO, COPTER_GUIDED),
    ],
)
def test_a_hold_we_did_not_order_is_somebody_elses(autopilot: int, flies: int, hold: int) -> None:
    story = Story(autopilot=autopilot, mode=flies)
    story.order(FlightMode.MISSION)
    story.tell(8)
    assert story.tell(4, custom_mode=hold)[-1:] == ([] if flies == PX4_POSITION else [Condition.HUMAN])
    assert story.classifier.condition(1) is Condition.HUMAN
    story.classifier.poll(story.now_s)
    if flies != PX4_POSITION:
        assert "held by somebody else, not by this service: its last order was 'mission' " in story.cause
    assert story.tell(5, custom_mode=PX4_MISSION if autopilot == 12 else COPTER_AUTO) == [Condition.LIVE]


def test_a_hold_of_ours_is_nobody_elses_however_long_its_command_takes() -> None:
    story = Story()
    story.order(FlightMode.HOLD, until_s=float("inf"))
    story.tell(30)
    assert story.tell(30, custom_mode=PX4_HOLD) == []
    story.order(FlightMode.MISSION)
    assert story.tell(10, custom_mode=PX4_MISSION) == []
    assert story.tell(4, custom_mode=PX4_HOLD) == [Condition.HUMAN]  # the order of half a minute ago is used up


@pytest.mark.parametrize(
    "ending", [{"seq": 19}, {"mission_state": 5}, {"seq": 0, "mission_state": 5}, {"system_status": 5}]
)
def test_a_mission_that_ends_and_a_failsafe_that_holds_are_no_human(ending: dict[str, int]) -> None:
    story = Story()
    expected = [Condition.FAILSAFE] if "system_status" in ending else []
    assert story.tell(20, custom_mode=PX4_HOLD, **ending) == expected


def test_a_hold_that_its_autopilot_explains_is_no_human() -> None:
    story = Story(mode=PX4_OFFBOARD)
    story.say("Offboard control lost")
    assert story.tell(20, custom_mode=PX4_HOLD) == []


def test_a_hold_after_take_off_or_since_before_we_listened_is_no_human() -> None:
    assert Story(mode=PX4_HOLD).tell(10) == []
    assert Story(mode=PX4_TAKEOFF).tell(10, custom_mode=PX4_HOLD) == []


@pytest.mark.parametrize(("announced", "condition"), [(True, Condition.LIVE), (False, Condition.FAILSAFE)])
def test_a_hold_that_was_announced_before_the_vehicle_was_heard_is_ours(announced: bool, condition: Condition) -> None:
    story = Story(mode=PX4_OFFBOARD)
    story.classifier = Classifier()
    if announced:
        story.order(FlightMode.HOLD, story.now_s + 5.0)
    story.classifier.watch(1, story.now_s)
    story.tell(2)
    story.tell(6, custom_mode=PX4_HOLD, system_status=5)
    assert story.classifier.condition(1) is condition


def test_a_landing_we_announced_is_no_failsafe_and_ends_landed() -> None:
    story = Story()
    story.classifier.expect(1, frozenset({FlightMode.LAND}), story.now_s)
    assert story.tell(20, custom_mode=PX4_LAND, vz=70, landed_state=4) == []
    assert story.tell(5, base_mode=DISARMED, relative_alt=0, vz=0, landed_state=1) == [Condition.LANDED]


def test_a_mission_that_ends_in_a_return_of_px4_is_nobodys_doing() -> None:
    story = Story()
    story.tell(5, seq=19)
    assert story.tell(30, custom_mode=PX4_RETURN) == []


def test_a_return_at_a_missions_end_is_nobodys_doing_for_a_service_that_starts_meanwhile_too() -> None:
    story = Story(mode=PX4_RETURN)
    assert story.tell(30, seq=19) == []


def test_falling_is_a_crash_and_stays_one() -> None:
    story = Story()
    assert story.fall(8) == [Condition.CRASHED]
    assert "sinking at" in story.changes[0].cause
    assert story.silence(20) == []


@pytest.mark.parametrize("from_m", [6, 10, 15])
@pytest.mark.parametrize("landed_state", [2, 4], ids=["in the air", "landing"])
def test_a_fall_that_is_over_before_it_could_be_seen_to_last_is_a_crash(from_m: int, landed_state: int) -> None:
    story = Story()
    assert story.tell(5, relative_alt=from_m * 1000) == []
    assert story.fall(3, landed_state=landed_state) == [Condition.CRASHED]
    assert story.cause.startswith("came down at ")
    assert story.tell(10, base_mode=DISARMED, landed_state=1) == []
    assert story.tell(5, base_mode=ARMED) == [Condition.LIVE]


def test_a_speed_that_its_height_contradicts_is_no_fall() -> None:
    assert Story().tell(20, vz=1200) == []


@pytest.mark.parametrize("autopilot", [12, 3])
def test_disarmed_in_the_air_is_a_crash_when_it_falls(autopilot: int) -> None:
    story = Story(autopilot=autopilot, mode=PX4_MISSION if autopilot == 12 else COPTER_AUTO)
    assert story.fall(10, base_mode=DISARMED, landed_state=1) == [Condition.CRASHED]
    assert story.cause.startswith("disarmed at ")


def test_disarmed_in_the_air_but_staying_up_there_is_believed_by_nobody() -> None:
    story = Story()
    assert story.tell(30, base_mode=DISARMED, landed_state=1) == [Condition.DISARMED]
    assert story.classifier.is_aloft(1, story.now_s)
    assert Condition.DISARMED.in_the_air
    assert not Condition.DISARMED.serves
    assert story.tell(6, base_mode=ARMED, landed_state=2) == [Condition.LIVE]


def test_one_heartbeat_that_says_disarmed_is_not_enough() -> None:
    story = Story()
    seen = story.tell(1, base_mode=DISARMED)
    assert seen + story.tell(20, base_mode=ARMED) == []


def test_a_restart_in_the_air_that_ends_on_the_ground_is_a_crash_and_no_landing() -> None:
    story = Story(autopilot=3, mode=COPTER_AUTO)
    assert story.silence(3.5) == [Condition.STALE]
    story.tell(20, base_mode=DISARMED, custom_mode=COPTER_STABILIZE, landed_state=1, relative_alt=0)
    assert story.classifier.condition(1) is Condition.CRASHED
    assert "down from 60.0 to 0.0 m above home" in story.cause


def restarted(story: Story, silent_s: float) -> None:
    """It is heard again after a silence, at the end of which it has started anew, on the ground."""
    story.silence(silent_s)
    story.boot_s = story.now_s
    story.values |= {"custom_mode": COPTER_STABILIZE, "landed_state": 1, "relative_alt": 0, "vz": 0, "seq": 0}
    story.classifier.hear(1, 1, "EXTENDED_SYS_STATE", story.values, story.now_s)  # before it says that it is disarmed
    story.tell(20, base_mode=DISARMED)


@pytest.mark.parametrize("from_m", [7, 10])
def test_a_restart_low_in_the_air_is_a_crash_though_a_landing_would_have_taken_no_longer(from_m: int) -> None:
    story = Story(autopilot=3, mode=COPTER_AUTO)
    story.tell(5, relative_alt=from_m * 1000)
    restarted(story, 3.0)
    assert story.classifier.condition(1) is Condition.CRASHED
    assert f"down from {from_m}.0 to 0.0 m above home" in story.cause
    assert "restarted 4.0 s after it was last seen up there" in story.cause


def test_one_that_landed_unheard_and_was_switched_off_and_on_has_landed() -> None:
    story = Story(autopilot=3, mode=COPTER_AUTO)
    story.tell(5, relative_alt=10_000)
    restarted(story, 30.0)
    assert story.classifier.condition(1) is Condition.LANDED


@pytest.mark.parametrize("heard_before", [True, False], ids=["it reported already", "it was not heard yet"])
@pytest.mark.parametrize(
    ("ago_s", "verdict"), [(1.5, Condition.CRASHED), (30.0, Condition.LANDED), (inf, Condition.LANDED)]
)
def test_one_that_flew_when_an_earlier_process_heard_it_is_not_taken_for_one_on_the_ground(
    ago_s: float, verdict: Condition, *, heard_before: bool
) -> None:
    story = Story()
    story.classifier, story.changes = Classifier(), []
    story.classifier.watch(1, story.now_s)
    on_the_ground = {"base_mode": DISARMED, "landed_state": 1, "relative_alt": 0}
    told_s = story.now_s - ago_s
    if heard_before:
        assert story.tell(1, **on_the_ground) == []
    story.classifier.was_flying(1, 20.0, told_s)
    story.tell(5, **on_the_ground)
    assert story.classifier.condition(1) is verdict


def test_one_that_flew_when_an_earlier_process_heard_it_may_fly_on() -> None:
    story = Story()
    story.classifier, story.changes = Classifier(), []
    story.classifier.watch(1, story.now_s)
    story.classifier.was_flying(1, 20.0, story.now_s - 10.0)
    assert story.tell(20, relative_alt=20_000) == []
    story.classifier.was_flying(1, 20.0, story.now_s - 10.0)
    assert story.tell(20) == []


def test_a_restart_in_the_air_without_positions_is_a_crash_when_it_must_be_down() -> None:
    story = Story(autopilot=3, mode=COPTER_AUTO)
    story.silence(3.5)
    for _ in range(15):
        fields = {"autopilot": 3, "type": 2, "custom_mode": COPTER_STABILIZE, "base_mode": DISARMED, "system_status": 3}
        story.classifier.hear(1, 1, "HEARTBEAT", fields, story.now_s)
        story.silence(1)
    seen = [change.after for change in story.changes]
    assert seen[-2:] == [Condition.DISARMED, Condition.CRASHED]
    assert Condition.LANDED not in seen
    assert story.changes[-1].at_s - story.changes[-2].at_s > 60 / 10  # longer than a fall from 60 m takes


def test_a_landing_while_nobody_listened_is_a_landing() -> None:
    story = Story()
    story.silence(60)
    story.tell(20, base_mode=DISARMED, landed_state=1, relative_alt=0)
    assert story.classifier.condition(1) is Condition.LANDED


def test_a_landing_on_a_roof_is_a_landing() -> None:
    story = Story()
    story.tell(5, relative_alt=10_000, landed_state=4, seq=19)
    assert story.tell(5, base_mode=DISARMED, landed_state=1) == [Condition.LANDED]


def test_a_crash_is_taken_back_from_who_evidently_flies() -> None:
    story = Story()
    assert story.fall(2.4) == [Condition.CRASHED]
    assert story.tell(10, vz=0) == [Condition.LIVE]


NO_AIRCRAFT = {"ground station": (6, 8), "gimbal": (26, 8), "ADS-B": (27, 8), "says PX4": (18, 12), "generic": (0, 8)}


@pytest.mark.parametrize(("mav_type", "autopilot"), NO_AIRCRAFT.values(), ids=NO_AIRCRAFT.keys())
@pytest.mark.parametrize("base_mode", [0, ARMED])
def test_a_heartbeat_of_no_aircraft_says_nothing_whatever_component_it_claims(
    mav_type: int, autopilot: int, base_mode: int
) -> None:
    story = Story()
    foreign = {"type": mav_type, "autopilot": autopilot, "base_mode": base_mode, "custom_mode": 0, "system_status": 4}
    for _ in range(10):
        assert story.tell(1) == []
        story.classifier.hear(1, 1, "HEARTBEAT", foreign, story.now_s)
        assert story.silence(0.9) == []
    for _ in range(8):
        story.classifier.hear(1, 1, "HEARTBEAT", foreign, story.now_s)
        story.silence(1)
    assert story.classifier.condition(1) is Condition.LINK_LOST  # it is no sign of life either


def test_an_aircraft_does_not_change_its_autopilot_in_flight() -> None:
    story = Story()
    other = {"type": 2, "autopilot": 3, "base_mode": 0, "custom_mode": 0, "system_status": 3}
    for _ in range(10):
        story.classifier.hear(1, 1, "HEARTBEAT", other, story.now_s)
        assert story.tell(1) == []


def test_a_low_battery_needs_to_recover_clearly_before_it_counts_as_full() -> None:
    story = Story()
    assert story.tell(6, battery_remaining=19) == [Condition.LOW_BATTERY]
    assert "19% of charge left" in story.cause
    assert story.tell(10, battery_remaining=23) == []
    assert story.tell(6, battery_remaining=40) == [Condition.LIVE]


def test_a_battery_that_is_not_measured_is_not_low() -> None:
    assert Story().tell(10, battery_remaining=-1) == []


def test_the_gravest_condition_counts() -> None:
    story = Story()
    story.tell(6, battery_remaining=10)
    assert story.silence(7) == [Condition.STALE, Condition.LINK_LOST]


@given(seed=st.integers(0, 2**32))
@settings(max_examples=15, deadline=None)
def test_random_loss_of_a_tenth_of_everything_never_flaps(seed: int) -> None:
    chance = random.Random(seed)
    story, in_a_row = Story(), 0
    for _ in range(120):
        if chance.random() < 0.1 and in_a_row < 4:  # five in a row would be a loss, and rightly one
            story.silence(1)
            in_a_row += 1
        else:
            story.tell(1)
            in_a_row = 0
    assert [change for change in story.changes if not change.after.serves] == []
    assert all(later.at_s - sooner.at_s >= 0.9 for sooner, later in pairwise(story.changes))


@given(values=st.lists(st.booleans(), min_size=1, max_size=60))
def test_something_lasting_changes_only_after_it_was_the_same_for_long_enough(values: list[bool]) -> None:
    lasting = Lasting(on_s=2.0, off_s=4.0)
    before = False
    for now_s, raw in enumerate(values):
        after = lasting.update(raw, float(now_s))
        if after != before:
            needed = 3 if after else 5
            assert values[max(0, now_s + 1 - needed) : now_s + 1] == [after] * needed
        before = after


@pytest.mark.parametrize(
    ("field", "value"), [("stale_after_s", 0.0), ("lost_after_s", 2.0), ("full_again", 0.1), ("crash_after_s", -1.0)]
)
def test_timings_that_make_no_sense_are_refused_by_name(field: str, value: float) -> None:
    with pytest.raises(ValueError, match=field):
        Timing(**{field: value})


def test_a_uav_that_is_no_longer_watched_changes_nothing_and_disturbs_nobody() -> None:
    story = Story()
    story.classifier.watch(2, story.now_s)
    story.classifier.unwatch(2)
    assert story.silence(20.0)[-1] is Condition.LINK_LOST
    assert {change.system_id for change in story.changes} == {1}


def test_what_it_was_told_before_a_pause_of_ours_is_no_human_when_it_is_heard_after() -> None:
    story = Story()
    story.tell(5)
    story.order(FlightMode.RETURN)
    story.now_s += 4.0  # longer than an order counts
    story.classifier.missed(story.now_s, 4.0)
    assert story.tell(5, custom_mode=PX4_RETURN) == []


def test_a_mission_that_tells_of_its_end_only_after_the_mode_has_is_no_human() -> None:
    story = Story()
    story.tell(5, seq=18)
    landing = story.values | {"custom_mode": PX4_LAND}
    for _ in range(2):
        story.classifier.hear(1, 1, "HEARTBEAT", landing, story.now_s)
        assert story.silence(1) == []
    assert story.tell(5, custom_mode=PX4_LAND, seq=19) == []
    early = Story()
    early.tell(5)
    assert early.tell(5, custom_mode=PX4_LAND) == [Condition.HUMAN]


def test_a_mission_whose_end_is_told_by_the_item_it_reached_alone_is_no_human() -> None:
    story = Story()
    story.tell(5, seq=17)
    home = story.values | {"custom_mode": PX4_RETURN}
    story.classifier.hear(1, 1, "MISSION_ITEM_REACHED", {"seq": 18}, story.now_s)
    for _ in range(12):  # each MISSION_CURRENT is lost
        story.classifier.hear(1, 1, "HEARTBEAT", home, story.now_s)
        assert story.silence(1) == []
    early = Story()
    early.classifier.hear(1, 1, "MISSION_ITEM_REACHED", {"seq": 18}, early.now_s)
    early.tell(2)
    assert early.tell(5, custom_mode=PX4_RETURN) == [Condition.HUMAN], "MISSION_CURRENT has the last word"
