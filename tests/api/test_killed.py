"""`kill -9` with aircraft in the air: at every step of the journal in virtual time, and for real."""

from pathlib import Path
from typing import Any

import pytest

from skyfolio import sim
from skyfolio.api.flights.journal import Entry
from skyfolio.api.flights.operation_views import State
from skyfolio.planner import EXAMPLES
from tests.api.field import ENDED, Case, Field, died, events_of
from tests.api.sky import Sky, flight

SCENARIO = EXAMPLES["paper"]().with_changes(slots=12, altitude_m=8.0)
SPEEDUP = 2.5
"""Of the real flight: enough of it is left to fly when a loaded machine has started another service."""
HOLD_ON_LOSS = 5
"""COM_OBL_RC_ACT of a PX4 that holds without setpoints; else no stream is begun."""
LOST = "uav-3"
WEIGHT = 0.5
"""What a change must be worth to these operations, kbit/s, before the restart and after."""
MATRIX = [
    Case("detected", "before"),
    Case("detected"),
    Case("classified"),
    Case("replanned"),
    Case("checked"),
    Case("uploading", "after", 2),
    Case("verified", "before"),
    Case("verified"),
    Case("flying"),
    Case("closed"),
]


async def killed_at(case: Case, folder: Path) -> None:
    """Fly, lose a UAV, kill the service at that step, start another one, and see the flight through."""
    field = Field(folder, SPEEDUP)
    async with field:
        async with field.service(dies=case) as first:
            path = await field.take_off(disruption_weight=WEIGHT)
            field.fleet.inject(sim.Kill(3))
            await died(first)
        async with field.service():
            ended = await field.until(path, *ENDED)
            journal = await field.get(f"{path}/journal")
            plans = (await field.get("/v1/plans"))["items"]
            events = await events_of(field)
    assert_seen_through(case, field.fleet, ended, journal, plans, events)


def assert_seen_through(
    case: Case,
    fleet: sim.Fleet,
    ended: dict[str, Any],
    journal: list[dict[str, Any]],
    plans: list[dict[str, Any]],
    events: list[dict[str, Any]],
) -> None:
    """By ground truth and by the books."""
    assert_flown_on(fleet, ended)
    assert_books_closed(case, ended, journal, plans, events)
    assert ended["disruption_weight"] == WEIGHT
    assert ended["recoveries"][-1]["disruption"]["weight_kbps"] == WEIGHT, "whichever service recovered"
    resumed = guidance_resumed(events)
    assert set(resumed.values()) <= {"ok"}, "what is on board of a survivor is known"
    if case.step in {"flying", "closed"}:  # else they may have been given new missions before it was read back
        assert set(resumed) == {"uav-1", "uav-2"}


def guidance_resumed(events: list[dict[str, Any]]) -> dict[str, str]:
    """Whether the mission on board of each survivor was recognised after a restart."""
    told = [event["data"] for event in events if event["kind"] == "guidance_resumed"]
    return {said["uav_id"]: said["level"] for said in told if said["uav_id"] != LOST}


def assert_flown_on(fleet: sim.Fleet, ended: dict[str, Any]) -> None:
    """Ground truth: the survivors were given each mission once, the last is a new one, and they landed."""
    assert ended["state"] == "completed", ended["error"]
    assert ended["lost"] == [LOST]
    for system_id in (1, 2):
        taken = [event.detail["mission_id"] for event in fleet.truth.happened("mission_accepted", system_id)]
        assert len(taken) == len(set(taken)), "no mission is sent twice"
        assert len(taken) >= 2, "the survivors fly a new plan"
        assert fleet.truth.happened("landed", system_id)


def assert_books_closed(
    case: Case,
    ended: dict[str, Any],
    journal: list[dict[str, Any]],
    plans: list[dict[str, Any]],
    events: list[dict[str, Any]],
) -> None:
    """The database tells the whole story, and nothing in it is left open."""
    assert ended["recoveries"], "the loss was answered"
    assert ended["recoveries"][-1]["outcome"] == "flying", ended["recoveries"]
    incidents = {entry["incident"] for entry in journal}
    for incident in incidents:
        steps = [entry["step"] for entry in journal if entry["incident"] == incident]
        assert steps[0] == "detected"
        assert steps.count("closed") == 1
        assert steps[-1] == "closed"
    assert {plan["status"] for plan in plans} <= {"succeeded", "interrupted", "cancelled"}
    assert [event["id"] for event in events] == list(range(1, len(events) + 1))
    kinds = [event["kind"] for event in events]
    assert kinds.count("uav_lost") == 1 or case == Case("detected", "before")
    assert kinds.count("service_started") == 2


@pytest.mark.parametrize("case", MATRIX, ids=str)
def test_wherever_the_service_is_killed_the_next_one_sees_the_flight_through(case: Case) -> None:
    with flight(SCENARIO) as flown:
        operation_id = flown.take_off(disruption_weight=WEIGHT)
        kill_at(case, flown)
        flown.inject(sim.Kill(3))
        flown.wait(lambda: flown.ground.service is None, f"never came to {case}")
        flown.let_pass(2.0)
        flown.start()
        flown.ended(operation_id)
        path = f"/v1/operations/{operation_id}"
        ended, journal = flown.http.get(path).json(), flown.http.get(f"{path}/journal").json()
        assert_seen_through(
            case, flown.fleet, ended, journal, flown.http.get("/v1/plans").json()["items"], flown.events()
        )


def kill_at(case: Case, flown: Sky) -> None:
    """Kill the service when it comes there."""
    seen = 0

    def die(entry: Entry, stored: bool) -> None:
        nonlocal seen
        if entry.step == case.step and stored == (case.when == "after"):
            seen += 1
            if seen == case.count:
                flown.ground.kill()

    flown.service.journal.listeners.append(die)


def test_a_uav_that_fell_after_the_service_that_streamed_is_found_lost_by_the_next_one() -> None:
    with flight(SCENARIO) as flown:
        flown.set_parameters({"COM_OBL_RC_ACT": HOLD_ON_LOSS})
        operation_id = flown.take_off(guidance="stream", stream_fallback="mission")
        modes_of = [vehicle.autopilot for vehicle in flown.fleet.vehicles.values()]
        assert {one.mode for one in modes_of} == {sim.Mode.GUIDED}
        flown.ground.kill()
        flown.wait(lambda: {one.mode for one in modes_of} == {sim.Mode.MISSION}, "somebody waits for setpoints")
        flown.inject(sim.Kill(3))
        flown.let_pass(2.0)
        flown.start()
        flown.ended(operation_id)
        assert_flown_on(flown.fleet, flown.http.get(f"/v1/operations/{operation_id}").json())
        assert guidance_resumed(flown.events()) == {"uav-1": "ok", "uav-2": "ok"}


def test_commands_in_doubt_before_the_flight_are_left_to_the_operator() -> None:
    with flight(SCENARIO) as flown:
        operation_id = flown.client.fly(flown.plan.id).id
        flown.until(operation_id, lambda view: view.state == State.LAUNCHING)
        flown.ground.kill()
        flown.let_pass(2.0)
        flown.start()
        found = flown.until(operation_id, lambda view: view.state == State.INTERRUPTED)
        assert "stopped while launching" in str(found.error)
        before = {number: len(flown.fleet.truth.happened("takeoff", number)) for number in (1, 2, 3)}
        answer = flown.http.post(f"/v1/operations/{operation_id}:abort", json={"action": "land"})
        assert answer.status_code == 200, answer.text
        assert answer.json()["state"] == "aborted"
        flown.let_pass(20.0)
        assert {number: len(flown.fleet.truth.happened("takeoff", number)) for number in (1, 2, 3)} == before


@pytest.mark.long
@pytest.mark.e2e
async def test_a_process_that_is_killed_with_uavs_in_the_air_is_followed_by_one_that_sees_the_flight_through(
    tmp_path: Path,
) -> None:
    await killed_at(Case("uploading", "after", 2), tmp_path / "uploading")


def test_the_matrix_has_every_step_of_a_recovery() -> None:
    recovery = {"detected", "classified", "replanned", "checked", "uploading", "verified", "flying", "closed"}
    assert {case.step for case in MATRIX} == recovery
