"""Nobody is heard for a while: the operation waits, says so, and goes on."""

from collections.abc import Iterator

import pytest

from skyfolio import sim
from skyfolio.api.flights.ends import UavEnd
from skyfolio.api.flights.operation_views import State
from skyfolio.mavlink_bridge import Autopilot
from skyfolio.planner import EXAMPLES
from tests.api.sky import Sky, flight

SCENARIO = EXAMPLES["paper"]().with_changes(slots=24, altitude_m=8.0)
MINIMAL = EXAMPLES["minimal"]()
ALONE = MINIMAL.with_changes(slots=12, altitude_m=8.0, uavs=MINIMAL.uavs[:1])
GOES_HOME = {
    Autopilot.PX4: {"NAV_DLL_ACT": 2.0, "COM_DL_LOSS_T": 5.0, "COM_FAIL_ACT_T": 1.0},
    Autopilot.ARDUPILOT: {"FS_GCS_ENABLE": 1.0, "FS_GCS_TIMEOUT": 5.0, "SYSID_MYGCS": 245.0},
}
"""Parameters by which it returns when it hears us no more, after 5 s."""


@pytest.fixture
def flown() -> Iterator[Sky]:
    with flight(SCENARIO) as made:
        yield made


def states(flown: Sky, operation_id: str) -> list[str]:
    """States the operation went through, by its events."""
    mine = [event["data"] for event in flown.events() if event["data"].get("operation_id") == operation_id]
    return [data["state"] for data in mine if "state" in data]


def mute(flown: Sky, *system_ids: int, for_s: float) -> None:
    flown.inject(*(sim.Mute(system_id, for_s=for_s) for system_id in system_ids))


def test_when_all_are_silent_nobody_is_lost_and_the_operation_goes_on_when_they_are_heard(flown: Sky) -> None:
    operation_id = flown.take_off()
    mute(flown, 1, 2, 3, for_s=20.0)
    dark = flown.until(operation_id, lambda view: view.state == State.LINK_LOST)
    assert dark.lost == []
    assert flown.until(operation_id, lambda view: view.state == State.FLYING).lost == []
    ended = flown.ended(operation_id)
    assert (ended.state, ended.lost, ended.error) == (State.COMPLETED, [], None)
    assert states(flown, operation_id)[-5:] == ["flying", "link_lost", "flying", "landing", "completed"]


def test_who_stays_silent_when_the_others_are_heard_again_is_lost_and_answered(flown: Sky) -> None:
    operation_id = flown.take_off()
    mute(flown, 1, 2, for_s=12.0)
    flown.inject(sim.Kill(3))
    flown.until(operation_id, lambda view: view.state == State.LINK_LOST)
    answered = flown.until(operation_id, lambda view: view.recoveries)
    assert answered.lost == ["uav-3"]
    assert answered.recoveries[0].outcome == "flying"
    assert flown.ended(operation_id).state == State.COMPLETED


def test_an_operator_can_end_an_operation_whose_link_is_lost(flown: Sky) -> None:
    operation_id = flown.take_off()
    mute(flown, 1, 2, 3, for_s=20.0)
    flown.until(operation_id, lambda view: view.state == State.LINK_LOST)
    assert flown.client.command(operation_id, "abort", action="hold").state == State.ABORTED


def test_an_operation_that_is_never_heard_again_ends_when_its_missions_must_have(
    flown: Sky, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("skyfolio.api.flights.operation.LANDING_LIMIT_S", 8.0)
    operation_id = flown.take_off()
    mute(flown, 1, 2, 3, for_s=600.0)

    view = flown.ended(operation_id)
    assert view.state == State.FAILED
    assert view.error == "link_lost: no vehicle was heard until uav-1, uav-2, uav-3 must have landed"
    assert view.lost == []


@pytest.mark.parametrize(
    ("autopilot", "for_s"),
    [(Autopilot.ARDUPILOT, 48.0), (Autopilot.ARDUPILOT, 90.0), (Autopilot.PX4, 90.0)],
    ids=["heard on their way", "heard on the ground", "px4 heard on the ground"],
)
def test_who_went_home_by_itself_while_nobody_was_heard_has_returned_and_is_not_lost(
    autopilot: Autopilot, for_s: float
) -> None:
    with flight(SCENARIO, autopilots=[autopilot.value]) as flown:
        flown.set_parameters(GOES_HOME[autopilot])
        operation_id = flown.take_off()
        dark = sim.Impairments(cut=True)
        flown.inject(*(sim.Impair(system_id, up=dark, down=dark, for_s=for_s) for system_id in (1, 2, 3)))
        flown.until(operation_id, lambda view: view.state == State.LINK_LOST)
        view = flown.ended(operation_id)
    assert {uav: one.end for uav, one in view.uavs.items()} == dict.fromkeys(SCENARIO.uav_ids, UavEnd.RETURNED)
    assert view.state == State.COMPLETED_PARTLY, view.error
    assert view.error is not None
    assert "uav-1 returned" in view.error


def test_a_single_uav_that_is_silent_is_waited_for() -> None:
    with flight(ALONE) as alone:
        operation_id = alone.take_off()
        mute(alone, 1, for_s=15.0)
        alone.until(operation_id, lambda view: view.state == State.LINK_LOST)
        ended = alone.ended(operation_id)
        assert (ended.state, ended.lost) == (State.COMPLETED, [])


def test_a_vehicle_shows_where_it_is_before_it_flies_for_us_because_it_is_asked(flown: Sky) -> None:
    def shown() -> bool:
        asked = {one.system_id for one in flown.fleet.truth.messages if one.name == "COMMAND_LONG"}
        placed = [one.uav_id for one in flown.client.vehicles() if one.lat_deg is not None and one.mode is not None]
        return asked == {1, 2, 3} and len(placed) == len(SCENARIO.uav_ids)

    flown.wait(shown)
