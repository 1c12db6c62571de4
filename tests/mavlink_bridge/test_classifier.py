"""The failure classifier as stories in virtual time."""

from __future__ import annotations

import random
from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mavlink_bridge.autopilots import FlightMode
from mavlink_bridge.classifier import Classifier
from mavlink_bridge.conditions import Change, Condition, Lasting, Timing

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
    assert story.tell(3, base_mode=DISARMED) == [Condition.CRASHED]
    assert story.tell(30, relative_alt=0) == []
    assert story.tell(5, base_mode=ARMED) == [Condition.LIVE]
    assert story.tell(5, relative_alt=60_000) == []
    assert story.tell(3, base_mode=DISARMED) == [Condition.CRASHED]


def test_a_failsafe_is_over_when_the_next_flight_begins() -> None:
    story = Story()
    assert story.tell(3, custom_mode=PX4_LAND) == [Condition.FAILSAFE]
    assert story.tell(2, base_mode=DISARMED, relative_alt=0) == [Condition.LANDED]
    assert story.tell(1, base_mode=ARMED, custom_mode=PX4_MISSION) == [Condition.LIVE]


@pytest.mark.parametrize(("autopilot", "mode"), [(12, PX4_POSITION), (3, COPTER_STABILIZE)])
def test_a_mode_nobody_commanded_is_a_human(autopilot: int, mode: int) -> None:
    story = Story(autopilot=autopilot, mode=PX4_MISSION if autopilot == 12 else COPTER_AUTO)
    assert story.tell(4, custom_mode=mode) == [Condition.HUMAN]
    assert "nobody commanded" in story.cause
    back = PX4_MISSION if autopilot == 12 else COPTER_AUTO
    assert story.tell(2, custom_mode=back) == []  # not at once
    assert story.tell(3) == [Condition.LIVE]


@pytest.mark.parametrize(("autopilot", "mode"), [(12, PX4_RETURN), (3, COPTER_RTL)])
def test_a_return_nobody_commanded_is_a_failsafe(autopilot: int, mode: int) -> None:
    story = Story(autopilot=autopilot, mode=PX4_MISSION if autopilot == 12 else COPTER_AUTO)
    assert story.tell(3, custom_mode=mode) == [Condition.FAILSAFE]


def test_a_critical_system_status_is_a_failsafe_in_any_mode_with_what_it_said() -> None:
    story = Story()
    story.say("Mission finished", severity=6)
    story.say("Critical battery level")
    assert story.tell(3, system_status=5, battery_remaining=6) == [Condition.FAILSAFE]
    assert story.cause.startswith("in mode 'mission', system status 5, said 'Critical battery level' 0.")
    assert story.cause.endswith("6% of charge left")


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
        assert "held by somebody else, not by us: our last order was 'mission' " in story.cause
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


def test_a_landing_we_announced_is_no_failsafe_and_ends_landed() -> None:
    story = Story()
    story.classifier.expect(1, frozenset({FlightMode.LAND}), story.now_s)
    assert story.tell(20, custom_mode=PX4_LAND, vz=70, landed_state=4) == []
    assert story.tell(5, base_mode=DISARMED, relative_alt=0, vz=0, landed_state=1) == [Condition.LANDED]


def test_falling_is_a_crash_and_stays_one() -> None:
    story = Story()
    assert story.tell(2, vz=1200, relative_alt=40_000) == [Condition.CRASHED]
    assert "sinking at 12.0 m/s" in story.cause
    assert story.silence(20) == []


def test_disarmed_in_the_air_is_a_crash() -> None:
    story = Story()
    assert story.tell(2, base_mode=DISARMED) == [Condition.CRASHED]
    assert story.cause == "disarmed at 60.0 m above home"


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
    story = Story()
    for _ in range(120):
        if chance.random() < 0.1:
            story.silence(1)
        else:
            story.tell(1)
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
