"""Explanations of plans and previews of changes over REST."""

import asyncio
from typing import Any

import pytest
from fastapi.testclient import TestClient

from skyfolio.api.client import ApiError, Client
from skyfolio.api.common.errors import BusyError, InvalidError
from skyfolio.api.common.settings import Settings
from skyfolio.api.http.routes.examples import PREVIEW_EXAMPLES, ROBUSTNESS_EXAMPLES
from skyfolio.api.plans.explanations import Explanations
from skyfolio.api.plans.jobs import Job, Solved
from skyfolio.api.plans.solver import LaneName, SolveError
from skyfolio.planner import (
    EXAMPLES,
    Changes,
    Comparison,
    Disturbances,
    Explanation,
    Losses,
    Plan,
    PlanStatus,
    Robustness,
    Trial,
    Uav,
    assess,
    explain,
    preview,
)
from skyfolio.planner.robustness import trial


@pytest.fixture
def service(client: TestClient) -> Client:
    return Client(http=client)


@pytest.fixture
def made(service: Client) -> Plan:
    return service.plan(EXAMPLES["minimal"]())


def test_the_service_explains_a_plan_as_the_planner_does(service: Client, made: Plan) -> None:
    found = service.explanation(made.id)
    assert found == explain(made)
    assert found.complete
    assert found.resolves > 0
    assert {row.method for row in found.worth} == {"bound", "resolve", "derivative"}


def test_the_service_assesses_a_plan_as_the_planner_does(service: Client, made: Plan) -> None:
    asked = Trial(disturbances=Disturbances(draws=20, seed=3), losses=Losses(at_slots=(1,)))
    found = service.robustness(made.id, asked)
    assert found == assess(made, asked)
    assert found.complete
    assert [loss.lost for loss in found.losses] == [("uav-1",), ("uav-2",), ("uav-1", "uav-2")]


def test_an_assessment_ends_in_time_and_says_what_is_left_out(service: Client) -> None:
    made = service.plan(EXAMPLES["paper"]())
    found = service.robustness(made.id, Trial(disturbances=Disturbances(draws=10_000)), deadline_s=0.3)
    assert not found.complete
    assert 0 < found.draws < 10_000
    assert found.notes


@pytest.mark.parametrize(
    ("body", "field"),
    [
        ({"disturbances": {"draws": 0}}, "disturbances.draws"),
        ({"disturbances": {"wind_mps": -1}}, "disturbances.wind_mps"),
        ({"losses": {"at_once": 3}}, "losses.at_once"),
        ({"losses": {"at_slots": [4]}}, "losses.at_slots"),
        ({"outage_share": 0}, "outage_share"),
        ({"surprise": 1}, "surprise"),
    ],
)
def test_a_trial_that_makes_no_sense_is_refused_by_field(
    client: TestClient, made: Plan, body: dict[str, Any], field: str
) -> None:
    answer = client.post(f"/v1/plans/{made.id}/robustness", json=body)
    assert answer.status_code == 422
    assert field in answer.text


def test_more_draws_than_can_be_computed_are_refused_at_the_edge(
    client: TestClient, made: Plan, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(trial, "MOST_CELL_DRAWS", 32 * 100)
    answer = client.post(f"/v1/plans/{made.id}/robustness", json={"disturbances": {"draws": 101}})
    assert answer.status_code == 422
    assert "disturbances.draws: 101 draws of 32 cells" in answer.text


@pytest.mark.parametrize(
    "example", ROBUSTNESS_EXAMPLES["requestBody"]["content"]["application/json"]["examples"].values()
)
def test_every_example_of_a_trial_is_one(client: TestClient, made: Plan, example: dict[str, Any]) -> None:
    answer = client.post(f"/v1/plans/{made.id}/robustness", json=example["value"])
    assert answer.status_code == 200, answer.text
    assert Robustness.model_validate_json(answer.content).plan_id == made.id


def test_an_explanation_without_resolves_has_bounds_and_derivatives_only(service: Client, made: Plan) -> None:
    found = service.explanation(made.id, resolves=0)
    assert found.resolves == 0
    assert {row.method for row in found.worth} == {"bound", "derivative"}
    assert "bounds and derivatives only" in found.notes[0]


def test_an_explanation_that_is_not_waited_for_is_found_later(client: TestClient, service: Client) -> None:
    made = service.plan(EXAMPLES["paper"]())
    path = f"/v1/plans/{made.id}/explanation"
    answer = client.get(path, params={"wait_s": 0})
    assert answer.status_code == 202
    assert answer.headers["Retry-After"] == "1"
    assert answer.json() == {"plan_id": made.id, "status": "running"}
    found = client.get(path, params={"wait_s": 60})
    assert found.status_code == 200
    again = client.get(path, params={"wait_s": 0})
    assert (again.status_code, again.content) == (200, found.content), "it is made once"


def test_an_explanation_of_no_plan_is_not_found_and_of_an_unfinished_one_a_conflict(client: TestClient) -> None:
    assert client.get("/v1/plans/plan-none/explanation").status_code == 404
    long = EXAMPLES["paper"]().with_changes(slots=400).model_dump(mode="json")
    location = client.post("/v1/plans", params={"starts": 64}, json=long).headers["Location"]
    assert client.get(f"{location}/explanation").status_code == 409
    client.post(f"{location}:cancel", params={"wait_s": 60})
    assert client.get(f"{location}/explanation", params={"wait_s": 60}).status_code == 200


def test_a_preview_of_a_scenario_compares_it_and_stores_nothing(
    client: TestClient, service: Client, made: Plan
) -> None:
    before = client.get("/v1/plans").json()["items"]
    wider = made.scenario.with_changes(
        uavs=tuple(uav.model_copy(update={"bandwidth_hz": 20_000.0}) for uav in made.scenario.uavs)
    )
    seen = service.preview(made.id, scenario=wider)
    assert seen.method == "resolve"
    assert seen.utility_before_bps == made.summary.utility_bps
    assert seen.utility_after_bps == pytest.approx(2 * made.summary.utility_bps, rel=1e-3)
    assert seen.gaining
    assert seen.losing == ()
    assert client.get("/v1/plans").json()["items"] == before


def test_a_preview_of_changes_is_that_of_the_planner(service: Client, made: Plan) -> None:
    changes = Changes(failed=("uav-2",))
    seen = service.preview(made.id, at_slot=2, changes=changes)
    assert seen == preview(made, at_slot=2, changes=changes)
    assert (seen.first_slot, seen.slots) == (2, 2)
    assert [move.uav_id for move in seen.uavs if move.flown_after_m is None] == ["uav-2"]


@pytest.mark.parametrize("example", PREVIEW_EXAMPLES["requestBody"]["content"]["application/json"]["examples"].values())
def test_every_example_of_a_preview_is_one(client: TestClient, made: Plan, example: dict[str, Any]) -> None:
    answer = client.post("/v1/plans:preview", json={**example["value"], "plan_id": made.id})
    assert answer.status_code == 200, answer.text
    assert Comparison.model_validate_json(answer.content).plan_id == made.id


@pytest.mark.parametrize(
    ("body", "status", "field"),
    [
        ({}, 422, "changes"),
        ({"scenario": None, "changes": None}, 422, "changes"),
        ({"changes": {"at_slot": 9}}, 422, "at_slot"),
        ({"changes": {"at_slot": 1, "failed": ["uav-9"]}}, 422, "failed"),
        ({"changes": {"at_slot": 1, "surprise": 1}}, 422, "changes.surprise"),
        ({"scenario": {"slots": 0}}, 422, "scenario.slots"),
    ],
)
def test_a_preview_that_makes_no_sense_is_refused_by_field(
    client: TestClient, made: Plan, body: dict[str, Any], status: int, field: str
) -> None:
    answer = client.post("/v1/plans:preview", json={"plan_id": made.id, **body})
    assert answer.status_code == status, answer.text
    assert field in [row["field"] for row in answer.json()["errors"]]


def test_a_preview_of_a_scenario_beyond_the_limits_or_of_no_plan_is_refused(
    client: TestClient, service: Client, made: Plan
) -> None:
    large = made.scenario.with_changes(slots=5_000)
    with pytest.raises(ApiError, match="slots: 5,000 slots are more than"):
        service.preview(made.id, scenario=large)
    answer = client.post("/v1/plans:preview", json={"plan_id": "plan-none", "changes": {"at_slot": 1}})
    assert answer.status_code == 404


def test_a_preview_ends_at_its_deadline_with_the_best_so_far(service: Client, made: Plan) -> None:
    seen = service.preview(made.id, scenario=EXAMPLES["paper"]().with_changes(slots=400), deadline_s=0.02)
    assert seen.status == "cancelled"
    assert seen.utility_after_bps > 0.0


def test_a_preview_that_cannot_be_flown_says_why(service: Client, made: Plan) -> None:
    """A zone from edge to edge between a UAV and its end: there is no way."""
    scenario = made.scenario.with_changes(
        slots=60,
        uavs=(Uav(id="uav-1", start_m=(20.0, 50.0), end_m=(180.0, 50.0)),),
        no_fly=({"kind": "polygon", "vertices_m": [(95.0, 0.0), (105.0, 0.0), (105.0, 100.0), (95.0, 100.0)]},),
    )
    with pytest.raises(ApiError, match="scenario: ") as refused:
        service.preview(made.id, scenario=scenario)
    assert refused.value.status == 422


# -- the book of explanations, with a lane that does as it is told ---------------------------------------------------


class FakeLane:
    """A lane whose solves end as the test says."""

    def __init__(self) -> None:
        self.ends: list[Solved | SolveError] = []
        self.jobs: list[Job] = []
        self.go = asyncio.Event()

    def reserve(self) -> int:
        return 0

    async def solve(self, job: Job, token: int | None = None) -> Solved:  # noqa: ARG002
        self.jobs.append(job)
        await self.go.wait()
        end = self.ends.pop(0)
        if isinstance(end, SolveError):
            raise end
        return end


@pytest.fixture
def lane() -> FakeLane:
    return FakeLane()


@pytest.fixture
def book(lane: FakeLane) -> Explanations:
    return Explanations({LaneName.REQUESTS: lane}, Settings())  # type: ignore[arg-type]


def solved(report: str, *, complete: bool = True) -> Solved:
    return Solved(status=PlanStatus.SUCCEEDED, report=report, complete=complete)


def test_two_that_ask_at_once_share_one_solve(lane: FakeLane, book: Explanations) -> None:
    async def story() -> None:
        lane.ends = [solved("yes")]
        first = asyncio.create_task(book.of("p", "{}", 3, 60))
        second = asyncio.create_task(book.of("p", "{}", 3, 60))
        assert await book.of("p", "{}", 3, 0) is None
        lane.go.set()
        assert (await first, await second) == ("yes", "yes")
        assert [job.request for job in lane.jobs] == [{"most_resolves": 3}]
        assert await book.of("p", "{}", 3, 0) == "yes"

    asyncio.run(story())


def test_a_failure_is_told_once_and_then_tried_again(lane: FakeLane, book: Explanations) -> None:
    async def story() -> None:
        lane.go.set()
        lane.ends = [
            SolveError(PlanStatus.FAILED, "it broke"),
            SolveError(PlanStatus.INFEASIBLE, "no way"),
            solved("yes"),
        ]
        with pytest.raises(BusyError, match="solver: it broke"):
            await book.of("p", "{}", 3, 60)
        with pytest.raises(InvalidError, match="plan_id: no way"):
            await book.of("p", "{}", 3, 60)
        assert await book.of("p", "{}", 3, 60) == "yes"

    asyncio.run(story())


def test_an_explanation_cut_short_is_returned_but_not_kept(lane: FakeLane, book: Explanations) -> None:
    async def story() -> None:
        lane.go.set()
        lane.ends = [solved("half", complete=False), solved("whole")]
        assert await book.of("p", "{}", 3, 60) == "half"
        assert await book.of("p", "{}", 3, 60) == "whole"
        assert await book.of("p", "{}", 3, 60) == "whole"

    asyncio.run(story())


def test_closing_ends_what_is_under_way(lane: FakeLane, book: Explanations) -> None:
    async def story() -> None:
        assert await book.of("p", "{}", 3, 0) is None
        await asyncio.sleep(0)
        await book.close()
        assert await book.of("p", "{}", 3, 0) is None, "it begins anew"
        await book.close()
        assert len(lane.jobs) <= 2

    asyncio.run(story())


def test_an_explanation_is_read_back_as_it_was_written(made: Plan) -> None:
    found = explain(made)
    assert Explanation.model_validate_json(found.model_dump_json()) == found
