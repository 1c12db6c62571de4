"""How many starts a plan is climbed from: what the request says, else what the service is set to, at most by size."""

import pytest
from fastapi.testclient import TestClient

from skyfolio.api.common.settings import Settings
from skyfolio.api.http.app import create_app
from skyfolio.api.plans.solving import starts_of
from skyfolio.planner import EXAMPLES, Plan, Scenario, plan
from skyfolio.planner.layouts import scattered


@pytest.mark.parametrize(("asked", "used"), [({}, 3), ({"starts": 1}, 1), ({"starts": 5}, 5)])
def test_a_request_that_does_not_say_starts_gets_those_of_the_service(asked: dict[str, int], used: int) -> None:
    scenario = scattered(3, 9, 20, seed=3)  # where one, three and five starts end at different plans
    with TestClient(create_app(Settings(plan_starts=3, warm_up=False))) as client:
        answer = client.post("/v1/plans", params={"wait_s": 60, **asked}, json=scenario.model_dump(mode="json"))
    paths = {starts: plan(scenario, n_starts=starts).trajectories_m for starts in (1, 3, 5)}
    made = Plan.model_validate(answer.json()).trajectories_m
    assert [starts for starts in paths if paths[starts] == made] == [used]


@pytest.mark.parametrize(
    ("scenario", "starts"),
    [
        (EXAMPLES["minimal"](), 11),
        (scattered(1, 1, 1, seed=1), 2),
        (EXAMPLES["paper"](), 24),
        (scattered(12, 36, 200, seed=1), 3),
    ],
)
def test_small_scenarios_need_fewer_starts_and_large_ones_get_fewer(scenario: Scenario, starts: int) -> None:
    assert starts_of(scenario, most=24) == starts
