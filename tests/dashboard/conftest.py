"""Plans and views to draw."""

import pytest

from skyfolio.api.dashboard.views import Operation
from skyfolio.planner import EXAMPLES, Plan, Scenario, plan


@pytest.fixture(scope="session")
def minimal() -> Scenario:
    return EXAMPLES["minimal"]()


@pytest.fixture(scope="session")
def small_plan(minimal: Scenario) -> Plan:
    return plan(minimal)


@pytest.fixture
def flying(small_plan: Plan) -> Operation:
    return Operation(
        id="op-1",
        state="flying",
        policy="auto",
        plan_id=small_plan.id,
        plan_ids=(small_plan.id,),
        vehicles={"uav-1": 1, "uav-2": 2},
        elapsed_s=7.0,
        slot=1,
    )
