from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skyfolio.mavlink_bridge import AUTOPILOT, HeartbeatMonitor, LinkEvent, LinkState

LIVE, STALE, LOST = LinkState.LIVE, LinkState.STALE, LinkState.LOST
NEIGHBOURS = {(LIVE, STALE), (STALE, LOST), (LOST, STALE), (STALE, LIVE)}
gaps = st.lists(st.one_of(st.floats(0.0, 2.9), st.floats(3.0, 4.9), st.floats(5.0, 20.0)), max_size=40)


def monitor_of_uav_1() -> HeartbeatMonitor:
    monitor = HeartbeatMonitor()
    monitor.watch(1, 0.0)
    return monitor


def beat(monitor: HeartbeatMonitor, *times_s: float) -> None:
    for time_s in times_s:
        monitor.heard(1, AUTOPILOT, time_s)


def changes(events: list[LinkEvent]) -> list[tuple[LinkState, LinkState]]:
    return [(event.before, event.after) for event in events]


def test_a_vehicle_falls_silent_is_lost_and_comes_back_step_by_step() -> None:
    monitor = monitor_of_uav_1()
    beat(monitor, 1.0, 2.0)
    assert monitor.poll(4.9) == []
    assert monitor.poll(5.0) == [
        LinkEvent(system_id=1, before=LIVE, after=STALE, silent_for_s=3.0, at_s=5.0),
    ]
    assert monitor.poll(6.9) == []
    assert monitor.poll(7.25) == [
        LinkEvent(system_id=1, before=STALE, after=LOST, silent_for_s=5.25, at_s=7.25),
    ]
    beat(monitor, 10.0, 11.0)
    assert monitor.poll(11.5) == []
    beat(monitor, 12.0)
    assert changes(monitor.poll(12.0)) == [(LOST, STALE)]
    beat(monitor, 13.0)
    assert monitor.poll(13.5) == []
    beat(monitor, 14.0)
    assert changes(monitor.poll(14.0)) == [(STALE, LIVE)]


def test_a_vehicle_never_heard_counts_from_when_it_was_watched() -> None:
    monitor = HeartbeatMonitor()
    monitor.watch(7, 100.0)
    assert changes(monitor.poll(104.0)) == [(LIVE, STALE)]
    assert changes(monitor.poll(105.0)) == [(STALE, LOST)]


def test_a_living_companion_does_not_hide_a_dead_autopilot() -> None:
    monitor = monitor_of_uav_1()
    for second in range(10):
        monitor.heard(1, 191, float(second))
    assert changes(monitor.poll(9.0)) == [(LIVE, STALE), (STALE, LOST)]


def test_the_heartbeat_of_another_vehicle_does_not_count() -> None:
    monitor = monitor_of_uav_1()
    monitor.heard(2, AUTOPILOT, 4.0)
    assert changes(monitor.poll(5.0)) == [(LIVE, STALE), (STALE, LOST)]
    assert monitor.watched == {1}


def test_a_silence_between_two_polls_is_still_reported() -> None:
    monitor = monitor_of_uav_1()
    beat(monitor, 1.0, 9.0)
    assert changes(monitor.poll(9.0)) == [(LIVE, STALE), (STALE, LOST)]


def test_one_late_heartbeat_is_no_recovery() -> None:
    monitor = monitor_of_uav_1()
    monitor.poll(20.0)
    beat(monitor, 21.0)
    assert monitor.poll(23.9) == []
    assert monitor.state(1) is LOST
    beat(monitor, 29.0)  # a new run begins here
    beat(monitor, 30.0)
    assert monitor.poll(30.0) == []


def test_an_unwatched_vehicle_is_forgotten() -> None:
    monitor = monitor_of_uav_1()
    monitor.unwatch(1)
    assert monitor.poll(100.0) == []
    monitor.unwatch(1)


def test_watching_again_does_not_reset_the_silence() -> None:
    monitor = monitor_of_uav_1()
    monitor.watch(1, 4.0)
    assert monitor.silent_for_s(1, 4.0) == 4.0


def test_a_clock_that_jumps_back_changes_nothing() -> None:
    monitor = monitor_of_uav_1()
    beat(monitor, 2.0, 0.5)
    assert monitor.poll(0.1) == []
    assert monitor.poll(4.9) == []
    assert changes(monitor.poll(5.0)) == [(LIVE, STALE)]


def test_a_boot_clock_that_runs_backwards_is_a_reboot_and_not_a_loss() -> None:
    monitor = monitor_of_uav_1()
    for second, boot_ms in enumerate([50_000, 51_000, 300, 1_300]):
        monitor.heard(1, AUTOPILOT, float(second), boot_ms)
    assert monitor.reboots(1) == 1
    assert monitor.poll(4.0) == []


def test_heartbeats_before_the_first_position_after_a_reboot_do_not_hide_it() -> None:
    monitor = monitor_of_uav_1()
    for second, boot_ms in ((0.0, 70_000), (1.0, 71_000), (4.0, 71_000), (5.0, 71_000), (8.0, 4_500)):
        monitor.heard(1, AUTOPILOT, second, boot_ms)
    assert monitor.reboots(1) == 1


def test_a_boot_clock_that_wraps_is_no_reboot() -> None:
    monitor = monitor_of_uav_1()
    monitor.heard(1, AUTOPILOT, 1.0, 2**32 - 500)
    monitor.heard(1, AUTOPILOT, 2.0, 500)
    assert monitor.reboots(1) == 0


def test_a_pause_of_our_own_is_not_their_silence() -> None:
    monitor = monitor_of_uav_1()
    beat(monitor, 1.0)
    monitor.missed(11.5, 10.0)
    assert monitor.poll(11.5) == []
    beat(monitor, 12.0, 13.0)
    assert monitor.poll(15.0) == []
    assert changes(monitor.poll(18.0)) == [(LIVE, STALE), (STALE, LOST)]  # and the pause is forgotten


def test_a_heartbeat_after_a_pause_is_no_recovery_from_a_loss() -> None:
    monitor = monitor_of_uav_1()
    beat(monitor, 1.0)
    monitor.missed(11.0, 10.0)
    beat(monitor, 11.0)
    assert monitor.poll(11.0) == []


@pytest.mark.parametrize("before_s", [0.0, 2.5, 4.9])
def test_who_is_really_gone_is_lost_no_later_than_the_limit_after_a_pause(before_s: float) -> None:
    monitor = monitor_of_uav_1()
    assert LOST not in {after for _, after in changes(monitor.poll(before_s))}
    monitor.missed(before_s + 30.0, 30.0)
    assert LOST not in {after for _, after in changes(monitor.poll(before_s + 30.0))}
    assert LOST in {after for _, after in changes(monitor.poll(before_s + 35.01))}


@pytest.mark.parametrize("stall_s", [0.3, 1.0, 4.0, 10.0])
def test_however_often_we_pause_a_loss_is_found(stall_s: float) -> None:
    monitor, now_s = monitor_of_uav_1(), 0.0
    while monitor.state(1) is not LOST:
        now_s += stall_s
        monitor.missed(now_s, stall_s)
        now_s += 0.05
        monitor.poll(now_s)
        assert now_s < max(10.0 + 2 * stall_s, 11 * (stall_s + 0.05))  # twice the limit, or a tenth of it listened


def test_two_long_pauses_with_a_blink_between_lose_nobody() -> None:
    monitor = monitor_of_uav_1()
    beat(monitor, 0.9)
    monitor.missed(11.0, 10.0)
    assert monitor.poll(11.05) == []
    monitor.missed(21.05, 10.0)
    assert LOST not in {after for _, after in changes(monitor.poll(21.1))}


@given(gaps=gaps)
def test_states_change_only_to_neighbours_and_each_change_starts_where_the_last_ended(gaps: list[float]) -> None:
    monitor = monitor_of_uav_1()
    now_s, events = 0.0, []
    for gap in gaps:
        now_s += gap
        beat(monitor, now_s)
        events += monitor.poll(now_s)
    assert set(changes(events)) <= NEIGHBOURS
    assert all(before.after is after.before for before, after in pairwise(events))
    assert (events[-1].after if events else LIVE) is monitor.state(1)


@given(gaps=gaps, extra=st.lists(st.floats(0, 400), max_size=60))
def test_asking_more_often_changes_no_state(gaps: list[float], extra: list[float]) -> None:
    seldom, often = monitor_of_uav_1(), monitor_of_uav_1()
    now_s, polls = 0.0, sorted(extra)
    heard_often: list[LinkEvent] = []
    for gap in gaps:
        now_s += gap
        while polls and polls[0] < now_s:
            heard_often += often.poll(polls.pop(0))
        beat(seldom, now_s)
        beat(often, now_s)
    assert changes(heard_often + often.poll(now_s)) == changes(seldom.poll(now_s))


@given(gaps=st.lists(st.floats(0.0, 2.99), min_size=1, max_size=60))
def test_a_vehicle_heard_often_enough_is_never_suspected(gaps: list[float]) -> None:
    monitor = monitor_of_uav_1()
    now_s = 0.0
    for gap in gaps:
        now_s += gap
        assert monitor.poll(now_s) == []
        beat(monitor, now_s)


@given(gaps=gaps)
def test_lost_means_silent_for_five_seconds_and_live_again_means_heard_for_four(gaps: list[float]) -> None:
    monitor = monitor_of_uav_1()
    now_s, lost_at = 0.0, None
    for gap in gaps:
        now_s += gap
        for event in monitor.poll(now_s):
            if event.after is LOST:
                assert event.silent_for_s >= 5.0
                lost_at = event.at_s
        beat(monitor, now_s)
        for event in monitor.poll(now_s):
            if event.after is LIVE and lost_at is not None:
                assert event.at_s - lost_at >= 2.0


@pytest.mark.parametrize(
    ("settings", "named"),
    [
        ({"stale_after_s": 0.0}, "stale_after_s"),
        ({"recovered_after_s": -1.0}, "recovered_after_s"),
        ({"lost_after_s": 3.0}, "lost_after_s"),
        ({"lost_after_s": float("nan")}, "lost_after_s"),
    ],
)
def test_impossible_timings_are_refused_by_name(settings: dict[str, float], named: str) -> None:
    with pytest.raises(ValueError, match=named):
        HeartbeatMonitor(**settings)
