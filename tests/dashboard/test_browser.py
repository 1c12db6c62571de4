"""The dashboard in a real headless Chromium, on a real service and simulated vehicles: what an operator does."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest

import sim
from planner import EXAMPLES
from tests.dashboard.stack import Page, Service, Vehicles, missing_browser

pytestmark = [
    pytest.mark.browser,
    pytest.mark.skipif(missing_browser() is not None, reason=missing_browser() or ""),
    pytest.mark.filterwarnings("default"),
]
SPEEDUP = 10.0
LOST = 3


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("dashboard")


@pytest.fixture(scope="module")
def service(folder: Path) -> Iterator[Service]:
    made = Service(folder, SPEEDUP)
    yield made
    made.stop()


@pytest.fixture(scope="module")
def browser(service: Service, folder: Path) -> Iterator[Page]:
    made = Page(service.url, folder)
    yield made
    made.close()


@pytest.fixture
def page(browser: Page) -> Iterator[Page]:
    browser.complaints()
    yield browser
    assert browser.complaints() == []


@pytest.fixture
def vehicles(service: Service) -> Iterator[Vehicles]:
    made = Vehicles(EXAMPLES["paper"](), service.endpoint, SPEEDUP)
    yield made
    made.stop()


def slot_of(page: Page) -> int:
    words = page.text(".sf-slotno").split()
    return int(words[-1]) if words and words[-1].isdigit() else -1


def plan_and_fly(page: Page, after_a_loss: str) -> None:
    """As an operator does it: the Plan page, its example, the dialog, and back on the live map."""
    page.open("/ui/plan")
    page.press("Plan it")
    page.see(".sf-figures th", "Jain index")
    page.press("Fly it")
    if after_a_loss != "replan and fly it":
        page.choose("When a UAV is lost", after_a_loss)
    page.press("Start: upload, arm, take off")
    page.see(".sf-what", "FLYING")


def test_before_anything_flies_the_page_says_what_to_do(page: Page) -> None:
    page.prefer("light")
    page.open()
    page.see(".sf-overlay h2", "No operation yet")
    page.see(".sf-fleet .sf-empty", "No vehicle is registered")
    for label in ("PAUSE", "HOLD ALL", "RTL ALL"):
        assert not page.button(label).is_enabled()
    page.press("Make a plan")
    page.see('nav a[aria-current="page"]', "Plan")


def test_a_plan_is_made_weighed_compared_and_exported(page: Page, folder: Path) -> None:
    page.open("/ui/plan")
    page.see(".sf-sub", "3 UAVs, 9 users")
    page.press("Plan it")
    page.see(".sf-figures th", "Jain index")
    page.press("Draw the curve")
    page.until(lambda: page.points(".sf-curve") >= 8, "eight plans on the trade-off curve")
    page.press("Show")
    page.see(".sf-figures thead th", "other")
    page.until(lambda: page.run("return document.querySelector('.sf-map').dataset.lost") == "uav-1", "a ghost")
    page.run("document.querySelector('.sf-work .sf-scroll:last-child').scrollTop = 0")
    page.shot("plan")
    page.press("Export .plan")
    saved = page.until(lambda: next(iter(folder.glob("*.plan")), None), "the download")
    assert json.loads(saved.read_text())["fileType"] == "Plan"


def test_users_and_uavs_are_placed_by_click_and_broken_rules_are_named(page: Page) -> None:
    page.open("/ui/plan")
    page.see(".sf-sub", "3 UAVs, 9 users")
    page.press("+ User")
    page.click_map(0.5, 0.55)
    page.see(".sf-sub", "3 UAVs, 10 users")
    page.press("+ UAV")
    page.click_map(0.45, 0.45)
    page.see(".sf-sub", "4 UAVs, 10 users")
    page.click_map(0.02, 0.5)  # west of the area
    page.see(".sf-fail", "lies outside area_m")
    assert not page.button("Plan it").is_enabled()
    page.press("Remove")
    page.click_map(0.02, 0.5)
    page.see(".sf-sub", "4 UAVs, 10 users")
    page.until(lambda: page.button("Plan it").is_enabled(), "a good scenario again")


def test_a_loss_is_seen_answered_and_recovered_from(page: Page, vehicles: Vehicles) -> None:
    plan_and_fly(page, "replan and fly it")
    page.until(lambda: slot_of(page) >= 3, "slot 3")
    page.shot("fly")
    assert page.run("return document.querySelector('.sf-map').dataset.uavs") == "3"
    vehicles.inject(sim.Kill(LOST))
    page.see('tr[data-uav="uav-3"][data-lost="true"]', "LOST")
    page.see('[data-kind="uav_lost"]', "uav-3 declared LOST")
    page.until(lambda: page.run("return document.querySelector('.sf-map').dataset.lost") == "uav-3", "the ghost")
    page.see(".sf-tx .sf-steps", "Flying the new plan")
    page.see(".sf-tx .sf-steps", "Replanned")
    page.see(".sf-stats", "after replan")
    page.shot("loss")
    page.run("document.querySelector('.sf-scrub [tabindex]').focus()")
    page.keys("ARROW_LEFT", 3)
    page.until(lambda: page.button("LIVE").get_attribute("aria-pressed") == "false", "the past")
    page.press("LIVE")
    page.prefer("dark")
    page.open()
    page.see(".sf-tx .sf-steps", "Flying the new plan")
    page.shot("loss-dark")
    page.resize(820, 1180)
    page.shot("loss-tablet")
    page.resize(1280, 800)
    page.prefer("light")
    page.see(".sf-what", "COMPLETED")


def test_hold_all_by_keyboard_ends_an_operation(page: Page, vehicles: Vehicles) -> None:
    plan_and_fly(page, "only tell me")
    page.keys("SHIFT+H")
    page.see(".sf-what", "ABORTED")
    page.until(lambda: {one.mode for one in vehicles.fleet.vehicles.values()} == {sim.Mode.HOLD}, "vehicles that hold")


def test_the_page_says_when_the_service_is_gone(page: Page) -> None:
    page.open()
    page.until(lambda: page.unreachable_controls() == [], "a name and a place in the tab order for every control")
