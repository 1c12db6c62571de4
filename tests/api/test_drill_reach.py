"""What drills reach: flights that are streamed to, vehicles' news, two operations at once; and how one is watched."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from fastapi.testclient import TestClient
from typer.testing import CliRunner

from skyfolio.api.cli.main import cli
from skyfolio.api.common.settings import Settings
from skyfolio.api.flights.operation_views import State
from skyfolio.api.http.app import create_app
from skyfolio.api.lab.torture.drill import Blow, Drill, Moment
from skyfolio.api.lab.torture.flight import Outcome, fly
from skyfolio.api.lab.torture.tally import Tally, moments_of
from skyfolio.mavlink_bridge.guidance import FallBack

IN_FLIGHT = Moment(state=State.FLYING, after_s=12.0)
KILL = Blow(when=IN_FLIGHT, kind="vehicle", options={"kind": "kill", "system_id": 3})


def killed(down_s: float) -> Blow:
    return Blow(when=IN_FLIGHT, kind="kill_service", options={"down_s": down_s})


def between(outcome: Outcome, first: str, last: str) -> list[str]:
    """The steps after the first one that has some words, and before the next that has others."""
    begin = next(place for place, step in enumerate(outcome.steps) if first in step)
    end = next(place for place, step in enumerate(outcome.steps[begin:], begin) if last in step)
    return outcome.steps[begin:end]


@pytest.mark.parametrize(
    ("fall_back", "modes", "then"), [(FallBack.MISSION, 3, "guidance_resumed"), (FallBack.HOLD, 0, "detected")]
)
def test_a_guard_flies_the_missions_of_a_service_that_died_while_it_streamed(
    fall_back: FallBack, modes: int, then: str
) -> None:
    outcome = fly(Drill(seed=2, slots=10, guidance="stream", fall_back=fall_back, blows=(killed(12.0),)))
    assert (outcome.broken, outcome.state) == ({}, "completed")
    dead = between(outcome, "STRIKE", then)
    assert sum("mode {'mode': 'MISSION'}" in step for step in dead) == modes


def test_a_service_that_is_back_at_once_waits_until_the_guard_lets_go_of_the_port() -> None:
    outcome = fly(Drill(seed=2, slots=10, guidance="stream", blows=(killed(0.2),)))
    assert (outcome.broken, outcome.state) == ({}, "completed")
    assert sum("guidance_resumed" in step for step in outcome.steps) == 3


def test_a_loss_of_a_streamed_flight_is_dealt_with() -> None:
    outcome = fly(Drill(seed=2, slots=10, guidance="stream", blows=(KILL,)))
    assert (outcome.broken, outcome.state) == ({}, "completed")
    assert any(event.kind == "recovery" for event in outcome.events)


def test_a_blow_strikes_when_something_happens_to_a_vehicle() -> None:
    second = Moment(vehicle="takeoff", nth=2)
    outcome = fly(Drill(seed=2, slots=8, blows=(Blow(when=second, kind="kill_service"),)))
    assert outcome.broken == {}
    assert sum(" takeoff " in step for step in between(outcome, "missions_uploaded", "STRIKE")) == 2
    assert outcome.moments == {("vehicle takeoff", "kill_service"): 1}


def test_two_operations_are_flown_and_aborted_at_once() -> None:
    abort = Blow(when=IN_FLIGHT, kind="abort", options={"actions": ["land"]})
    outcome = fly(Drill(seed=2, slots=8, beside=True, blows=(abort,)))
    assert (outcome.broken, outcome.state) == ({}, "aborted")
    aborted = {event.data["operation_id"] for event in outcome.events if event.data.get("state") == "aborted"}
    assert len(aborted) == 2


def test_a_loss_in_the_operation_beside_is_dealt_with_there() -> None:
    outcome = fly(Drill(seed=2, slots=8, beside=True, blows=(KILL,)))
    assert (outcome.broken, outcome.state) == ({}, "completed")
    ends = [event.data for event in outcome.events if event.data.get("state") in {"completed", "failed"}]
    assert sorted(end["state"] for end in ends) == ["completed", "failed"]


@pytest.mark.parametrize("stored", [State.UPLOADING, State.LAUNCHING], ids=str)
def test_a_service_may_die_while_the_second_operation_is_started(stored: State) -> None:
    early = Blow(when=Moment(state=stored), kind="kill_service", options={"down_s": 0.2})
    assert fly(Drill(seed=2, slots=8, beside=True, blows=(early,))).broken == {}


def test_a_blow_after_the_end_of_the_operation_is_no_fault_of_the_service() -> None:
    abort = Blow(when=IN_FLIGHT, kind="abort", options={"actions": ["land"]})
    late = Moment(state=State.ABORTED, after_s=0.5)
    falls = Blow(when=late, kind="vehicle", options={"kind": "motor_failure", "system_id": 2})
    assert fly(Drill(seed=2, slots=8, blows=(abort, falls))).broken == {}


def test_what_struck_at_each_moment_is_told() -> None:
    tally = Tally()
    tally.moments.update({("before swapping", "kill"): 2, ("before swapping", "mute"): 1, ("start", "kill"): 1})
    assert moments_of(tally.moments) == [["before swapping", "kill 2, mute 1"], ["start", "kill 1"]]


def test_a_replayed_drill_is_told_step_by_step_and_stored_for_the_dashboard(tmp_path: Path) -> None:
    case, database = tmp_path / "drill.json", tmp_path / "drill.sqlite"
    case.write_text(f'{{"drill": {Drill(seed=2, slots=8, blows=(KILL,)).model_dump_json()}}}')
    told = CliRunner().invoke(cli, ["torture", "--replay", str(case), "--recording", str(database)])
    assert told.exit_code == 0, told.output
    strike, lost, swapped = (told.stdout.index(words) for words in ("STRIKE", "uav_lost", "journal 1 flying"))
    assert strike < lost < swapped
    with TestClient(create_app(Settings(database_url=f"sqlite+aiosqlite:///{database}"))) as client:
        operation: dict[str, Any] = client.get("/v1/operations").json()["items"][0]
        view = client.get(f"/v1/operations/{operation['id']}").json()
        track = client.get(f"/v1/operations/{operation['id']}/track").json()
    assert view["state"] == "completed"
    assert view["lost"] == ["uav-3"]
    assert len(track) > 20


def test_only_a_replay_is_recorded(tmp_path: Path) -> None:
    refused = CliRunner().invoke(cli, ["torture", "--recording", str(tmp_path / "drill.sqlite")])
    assert refused.exit_code != 0
    assert "--replay" in str(refused.exception)
