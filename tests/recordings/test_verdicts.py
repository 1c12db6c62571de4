"""What the bridge concludes from recorded flights of real autopilots; README.md says what happened."""

from __future__ import annotations

import pytest

from skyfolio.mavlink_bridge.conditions import Condition
from tests.recordings.player import Played, play
from tests.recordings.reading import NAMES, vehicles

LOST_AFTER_S = 5.5
"""Within so many seconds of the last message a killed vehicle is lost."""
KILLED = {"ccc-kill-calm": (3, 82.42), "ccp-kill-p": (2, 88.69), "ppp-kill-calm": (3, 88.0)}
"""Who was killed, and when it was heard last."""
STOPPED = {"ccc-human-stop": (2, 90.05), "ppp-human-stop": (2, 91.33)}
"""Who was stopped for 8 s, and when it was heard last before."""
HELD = {"ccc-human-stop": (1, 55.10), "ppp-human-stop": (1, 56.67)}
SENT_HOME = [
    *[("ccc-rtl-batt", 1, 53.02), ("ppp-rtl-batt", 1, 56.76), ("ppp-crawl2", 1, 53.68), ("ppp-crawl2", 2, 54.73)],
]
FAILED = {
    ("ccc-human-stop", 2): (121.29, "'GCS Failsafe'"),
    ("ccc-human-stop", 3): (121.22, "'GCS Failsafe'"),
    ("ccc-rtl-batt", 2): (79.54, "'GCS Failsafe'"),
    ("ccc-rtl-batt", 3): (79.67, "'GCS Failsafe'"),
    ("ccc-reboot", 1): (83.11, "'GCS Failsafe'"),
    ("ppp-gps-motor", 1): (65.20, "'Failsafe activated'"),
    ("ppp-rtl-batt", 2): (91.98, "'Low battery', 'Failsafe activated: entering Hold for 5 seconds'"),
}
"""Failsafes: when the mode was seen, and the words that belong to them."""
RESTARTED = ("ccc-reboot", 2)
LANDS = {
    *[("ccc-gps-motor", 2), ("ccc-gps-motor", 3), ("ccc-kill-calm", 2), ("ccp-kill-p", 3), ("ppp-gps-motor", 2)],
    *[("ppp-kill-calm", 1)],
}
"""Who is seen to land as its mission has it before the recording ends."""
TROUBLED = {
    *((name, system_id) for trouble in (KILLED, STOPPED, HELD) for name, (system_id, _) in trouble.items()),
    *((name, system_id) for name, system_id, _ in SENT_HOME),
    *FAILED,
    RESTARTED,
}


@pytest.fixture(scope="module")
def flights() -> dict[str, Played]:
    """Every recording, played once."""
    return {name: play(name) for name in NAMES}


def first(played: Played, system_id: int, condition: Condition) -> float:
    """When it was first in a condition."""
    return next(change.at_s for change in played.changes[system_id] if change.after is condition)


def test_every_recording_has_its_vehicles_and_they_are_read_as_what_they_are(flights: dict[str, Played]) -> None:
    for name, played in flights.items():
        kinds = [str(state.autopilot)[0] for _, state in sorted(played.states.items())]
        assert "".join(kinds) == name[: len(kinds)].replace("c", "a"), name


@pytest.mark.parametrize("name", KILLED)
def test_who_is_killed_is_lost_once_and_in_time(flights: dict[str, Played], name: str) -> None:
    system_id, last_heard_s = KILLED[name]
    assert flights[name].conditions(system_id) == [Condition.STALE, Condition.LINK_LOST]
    lost_s = first(flights[name], system_id, Condition.LINK_LOST)
    assert 5.0 <= lost_s - last_heard_s + 0.01 <= LOST_AFTER_S


@pytest.mark.parametrize("name", NAMES)
def test_whoever_nothing_happens_to_is_live_until_it_lands(flights: dict[str, Played], name: str) -> None:
    for system_id in set(vehicles(name)) - {system for at, system in TROUBLED if at == name}:
        losses = [change.after for change in flights[name].losses(system_id)]
        assert losses == ([Condition.LANDED] if (name, system_id) in LANDS else []), (name, system_id)


@pytest.mark.parametrize("name", STOPPED)
def test_who_is_stopped_is_lost_and_comes_back(flights: dict[str, Played], name: str) -> None:
    system_id, last_heard_s = STOPPED[name]
    assert flights[name].conditions(system_id)[:4] == [
        *[Condition.STALE, Condition.LINK_LOST, Condition.BACK, Condition.LIVE],
    ]
    assert first(flights[name], system_id, Condition.LINK_LOST) - last_heard_s <= LOST_AFTER_S


@pytest.mark.parametrize("name", HELD)
def test_who_another_station_stops_is_a_humans(flights: dict[str, Played], name: str) -> None:
    system_id, at_s = HELD[name]
    assert flights[name].conditions(system_id)[0] is Condition.HUMAN
    assert 1.0 <= first(flights[name], system_id, Condition.HUMAN) - at_s <= 1.3


@pytest.mark.parametrize(("name", "system_id", "at_s"), SENT_HOME)
def test_who_another_station_sends_home_is_a_humans_and_no_failsafe(
    flights: dict[str, Played], name: str, system_id: int, at_s: float
) -> None:
    assert flights[name].conditions(system_id) == [Condition.HUMAN]
    assert 1.0 <= first(flights[name], system_id, Condition.HUMAN) - at_s <= 1.3


@pytest.mark.parametrize(("name", "system_id"), FAILED)
def test_a_failsafe_is_one_and_is_explained_by_its_own_words(
    flights: dict[str, Played], name: str, system_id: int
) -> None:
    at_s, words = FAILED[name, system_id]
    (seen, *_) = [change for change in flights[name].changes[system_id] if change.after is Condition.FAILSAFE]
    assert 0.5 <= seen.at_s - at_s <= 0.8
    assert f"said {words}, " in seen.cause
    assert Condition.HUMAN not in flights[name].conditions(system_id)


@pytest.mark.parametrize("name", ["ppp-gps-motor", "ppp-rtl-batt"])
def test_a_failsafe_that_lands_ends_landed(flights: dict[str, Played], name: str) -> None:
    (system_id,) = [system for at, system in FAILED if at == name]
    assert flights[name].conditions(system_id)[-2:] == [Condition.FAILSAFE, Condition.LANDED]


def test_a_restart_in_the_air_is_known_by_its_disarming_and_is_no_landing(flights: dict[str, Played]) -> None:
    name, system_id = RESTARTED
    assert flights[name].conditions(system_id) == [Condition.STALE, Condition.DISARMED, Condition.CRASHED]
    assert first(flights[name], system_id, Condition.DISARMED) - 55.62 <= 2.0


def test_a_failsafe_that_continues_the_mission_is_live_with_a_warning(flights: dict[str, Played]) -> None:
    played = flights["ccc-stream-svckill"]
    for system_id in (1, 3):
        assert played.conditions(system_id) == []
        assert [words for _, words in played.warnings[system_id]] == ["in mode 'mission', system status 5"]


def test_nobody_else_has_a_warning(flights: dict[str, Played]) -> None:
    warned = {name for name, played in flights.items() if any(played.warnings.values())}
    assert warned == {"ccc-stream-svckill"}


@pytest.mark.parametrize("name", ["ccc-kill-calm", "ppp-kill-calm", "ccp-kill-p"])
@pytest.mark.parametrize("from_s", [45.0, 70.0])
def test_a_service_that_starts_in_the_middle_concludes_the_same(name: str, from_s: float) -> None:
    killed, _ = KILLED[name]
    played = play(name, from_s=from_s)
    for system_id in vehicles(name):
        losses = {change.after for change in played.losses(system_id)} - {Condition.LANDED}
        assert losses == ({Condition.LINK_LOST} if system_id == killed else set()), system_id
