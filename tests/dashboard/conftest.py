"""Plans and views to draw, and a browser to look at them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from skyfolio.api.dashboard.views import Operation
from skyfolio.planner import EXAMPLES, Plan, Scenario, plan
from tests.dashboard.stack import Page


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


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("dashboard")


@pytest.fixture(scope="module")
def browser(folder: Path) -> Iterator[Page]:
    made = Page(folder)
    yield made
    made.close()


@pytest.fixture
def page(browser: Page) -> Iterator[Page]:
    """Ask for it after the service, so that it is left before the service ends."""
    browser.prefer("light")
    browser.complaints()
    yield browser
    assert browser.complaints() == []
    browser.leave()
