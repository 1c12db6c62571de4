"""Drills in virtual time: drawn from seeds, replayed exactly, and broken by a service that is wrong."""

from __future__ import annotations

import json
import logging
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from skyfolio import sim
from skyfolio.api.cli.files import UsageError
from skyfolio.api.cli.main import cli
from skyfolio.api.flights.journal import IncidentLog, Step
from skyfolio.api.flights.operation_views import State
from skyfolio.api.lab.torture.blows import BLOWS
from skyfolio.api.lab.torture.campaign import read_case, write_case
from skyfolio.api.lab.torture.drill import Blow, Drill, Moment
from skyfolio.api.lab.torture.flight import Outcome, fly
from skyfolio.api.lab.torture.generator import drill_of
from skyfolio.api.lab.torture.invariants import AT_END, MEANWHILE
from skyfolio.api.lab.torture.shrink import smaller
from skyfolio.api.lab.torture.tally import Result, Tally, table_of
from skyfolio.mavlink_bridge import Autopilot
from skyfolio.mavlink_bridge.classifier import Classifier

pytestmark = pytest.mark.long

DRILLS = Path(__file__).parent / "drills"
AT_FLIGHT = Moment(state=State.FLYING, after_s=8.0)
KILL = Blow(when=AT_FLIGHT, kind="vehicle", options={"kind": "kill", "system_id": 3})
TAKE_OVER = Blow(when=AT_FLIGHT, kind="vehicle", options={"kind": "mode_change", "system_id": 1, "mode": "POSITION"})


def test_a_seed_draws_the_same_drill_each_time_and_seeds_draw_every_kind_of_blow() -> None:
    drills = [drill_of(seed) for seed in range(300)]
    assert drills == [drill_of(seed) for seed in range(300)]
    assert {blow.kind for drill in drills for blow in drill.blows} == set(BLOWS)
    aimed = {blow.when.step for drill in drills for blow in drill.blows}
    assert aimed >= set(Step) - {Step.WAITING}


def test_a_drill_survives_its_file(tmp_path: Path) -> None:
    drill = drill_of(4)
    result = Result(
        seed=4,
        state="failed",
        broken={"it": "broke"},
        coverage=Tally().coverage,
        virtual_s=1.0,
        wall_s=1.0,
        small=drill,
    )
    assert read_case(write_case(tmp_path, result)) == drill


@pytest.mark.parametrize("changed", [{"step": "uploading", "state": "flying"}, {"nth": 0}, {"at_slot": 3}])
def test_a_moment_that_means_nothing_is_refused(changed: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=r"step and state|greater than|Extra inputs"):
        Moment(**changed)


def test_a_service_killed_in_the_middle_of_an_upload_leaves_nothing_broken() -> None:
    after_upload = Moment(step=Step.UPLOADING, stored=True)
    outcome = fly(Drill(seed=2, loss=0.1, blows=(KILL, Blow(when=after_upload, kind="kill_service"))))
    assert outcome.broken == {}
    assert outcome.state == "completed"
    assert set(outcome.coverage) == {("flying", "kill"), ("flying", "kill_service")}


def test_who_stays_silent_when_two_others_are_heard_again_is_lost_and_answered() -> None:
    at = Moment(state=State.FLYING, after_s=0.5)
    mutes = [Blow(when=at, kind="vehicle", options={"kind": "mute", "system_id": n, "for_s": 12.0}) for n in (1, 2)]
    outcome = fly(Drill(seed=3, slots=16, blows=(*mutes, KILL.model_copy(update={"when": at}))))
    assert (outcome.broken, outcome.state) == ({}, "completed")
    recoveries = [event.data["outcome"] for event in outcome.events if event.kind == "recovery"]
    assert recoveries == ["flying"]


@pytest.mark.parametrize("file", sorted(DRILLS.glob("*.json")), ids=lambda file: file.stem)
def test_a_drill_that_once_broke_something_breaks_nothing_now(file: Path) -> None:
    assert fly(read_case(file)).broken == {}


# -- what must hold is seen to be broken where it is -------------------------------------------------------------------


def broken_by(monkeypatch: pytest.MonkeyPatch, wrong: Callable[[pytest.MonkeyPatch], None], *blows: Blow) -> Outcome:
    wrong(monkeypatch)
    return fly(Drill(seed=2, slots=8, blows=blows))


def never_closes(patch: pytest.MonkeyPatch) -> None:
    real = IncidentLog.step

    async def step(self: IncidentLog, step: Step, **data: Any) -> None:
        if step is not Step.CLOSED:
            await real(self, step, **data)

    patch.setattr(IncidentLog, "step", step)


def loses_everybody(patch: pytest.MonkeyPatch) -> None:
    real = Classifier.alive

    def alive(self: Classifier, system_id: int, component_id: int, now_s: float) -> None:
        if system_id != 2 or now_s < 15.0:
            real(self, system_id, component_id, now_s)

    patch.setattr(Classifier, "alive", alive)
    patch.setattr(Classifier, "hear", _deaf_to_2(Classifier.hear))


def _deaf_to_2(real: Callable[..., Any]) -> Callable[..., Any]:
    def hear(self: Classifier, system_id: int, component: int, name: str, fields: Any, heard_s: float) -> None:
        if system_id != 2 or heard_s < 15.0:
            real(self, system_id, component, name, fields, heard_s)

    return hear


@pytest.mark.parametrize(
    ("wrong", "blows", "invariant"),
    [
        (never_closes, (KILL,), "every incident is closed once"),
        (loses_everybody, (), "nobody healthy is lost"),
    ],
    ids=["never closes", "false loss"],
)
def test_a_service_that_is_wrong_breaks_what_must_hold(
    monkeypatch: pytest.MonkeyPatch,
    wrong: Callable[[pytest.MonkeyPatch], None],
    blows: tuple[Blow, ...],
    invariant: str,
) -> None:
    assert invariant in broken_by(monkeypatch, wrong, *blows).broken


def test_every_invariant_says_why() -> None:
    for name, check in {**MEANWHILE, **AT_END}.items():
        assert check.__doc__, name


# -- shrinking and the command -----------------------------------------------------------------------------------------


def test_a_failing_drill_is_made_as_small_as_it_still_fails() -> None:
    drill = Drill(
        seed=9,
        slots=16,
        autopilots=(Autopilot.ARDUPILOT, Autopilot.PX4),
        loss=0.1,
        blows=(TAKE_OVER, KILL, Blow(when=Moment(), kind="full_disk")),
    )
    small = smaller(
        drill, lambda one: KILL.kind in {blow.kind for blow in one.blows if blow.options.get("kind") == "kill"}
    )
    assert small == Drill(seed=9, slots=8, blows=(KILL.model_copy(update={"when": Moment(state=State.FLYING)}),))


def test_the_coverage_is_a_table_of_blows_by_states() -> None:
    tally = Tally()
    tally.coverage.update({("flying", "kill"): 2, ("paused", "mute"): 1})
    assert table_of(tally.coverage) == [["", "flying", "paused"], ["kill", "2", "·"], ["mute", "·", "1"]]


def test_a_campaign_that_was_stopped_goes_on_and_flies_again_what_broke(tmp_path: Path) -> None:
    out, file = tmp_path / "out", tmp_path / "out" / "drills.jsonl"
    command = ["torture", "--out", str(out), "--json"]
    first = CliRunner().invoke(cli, [*command, "--drills", "2", "--seed", "1"])
    assert first.exit_code == 0, first.output
    flown = json.loads(first.stdout)
    results = [Result.of_line(line) for line in file.read_text().splitlines()]
    assert [result.seed for result in results] == [1, 2]
    broke = replace(results[1], broken={"it": "broke"})
    file.write_text(results[0].line() + broke.line() + '{"seed": 3, "sta')
    summed = CliRunner().invoke(cli, [*command, "--drills", "0", "--resume"])
    assert summed.exit_code == 1
    report = json.loads(summed.stdout)
    assert (report["drills"], report["failed"], report["coverage"]) == (2, 1, flown["coverage"])
    gone_on = CliRunner().invoke(cli, [*command, "--drills", "2", "--seed", "1", "--resume"])
    assert gone_on.exit_code == 0, gone_on.output
    assert json.loads(gone_on.stdout)["moments"] == flown["moments"]
    assert [Result.of_line(line).seed for line in file.read_text().splitlines()] == [1, 2, 2]


def test_a_campaign_goes_on_where_none_was_begun(tmp_path: Path) -> None:
    out = tmp_path / "new" / "out"
    flown = CliRunner().invoke(cli, ["torture", "--out", str(out), "--drills", "1", "--resume", "--json"])
    assert flown.exit_code == 0, flown.output
    assert [Result.of_line(line).seed for line in (out / "drills.jsonl").read_text().splitlines()] == [1]


def test_results_that_are_none_and_a_campaign_of_nothing_are_refused(tmp_path: Path) -> None:
    (tmp_path / "drills.jsonl").write_text('{"seed": 1}\n')
    for options, complaint in (
        (["--resume"], r"drills.jsonl, line 1"),
        (["--drills", "0"], "--drills: 0 flies nothing"),
    ):
        refused = CliRunner().invoke(cli, ["torture", *options, "--out", str(tmp_path)])
        with pytest.raises(UsageError, match=complaint):
            raise refused.exception or AssertionError(refused.output)


def test_the_command_replays_a_file_and_refuses_what_is_none(tmp_path: Path) -> None:
    file = tmp_path / "drill.json"
    file.write_text(json.dumps({"drill": {"seed": 1, "slots": 4}}))
    done = CliRunner().invoke(cli, ["torture", "--replay", str(file), "--json"])
    assert done.exit_code == 0, done.output
    shown = json.loads(done.stdout)
    assert (shown["state"], shown["broken"]) == ("completed", {})
    file.write_text("{}")
    refused = CliRunner().invoke(cli, ["torture", "--replay", str(file)])
    assert refused.exit_code != 0
    assert logging.root.manager.disable == logging.NOTSET, "what it quietened is heard again"


def test_drills_with_base_stations_are_few_have_every_fault_of_the_radio_and_leave_the_others_as_they_are() -> None:
    drills = {seed: drill_of(seed) for seed in range(1, 401)}
    served = [drill for drill in drills.values() if drill.stations]
    assert [drill.seed for drill in served] == list(range(19, 401, 20))
    faults = {str(blow.options.get("kind")) for drill in served for blow in drill.blows}
    assert faults >= set(sim.RADIO_FAULTS)
    others = [blow for drill in drills.values() if not drill.stations for blow in drill.blows]
    assert not {str(blow.options.get("kind")) for blow in others} & set(sim.RADIO_FAULTS)


@pytest.mark.parametrize("kind", sorted(sim.RADIO_FAULTS))
def test_a_loss_beside_a_base_station_that_fails_breaks_nothing(kind: str) -> None:
    fault = Blow(when=AT_FLIGHT, kind="vehicle", options={"kind": kind, "system_id": 1})
    outcome = fly(Drill(seed=7, slots=10, stations=True, bias_db=-6.0, blows=(fault, KILL)))
    assert outcome.broken == {}
    kinds = {event.kind for event in outcome.events}
    assert {"allocations", "reassociated"} <= kinds
