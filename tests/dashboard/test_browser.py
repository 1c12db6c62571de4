"""The dashboard in a real headless Chromium, on a real service: what an operator does before anything flies."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from selenium.webdriver.common.by import By

from skyfolio.api.dashboard.map_scene import sketch
from skyfolio.planner import EXAMPLES
from tests.dashboard.components import stray_errors
from tests.dashboard.stack import SPEEDUP, Page, Service, key_for, missing_browser

pytestmark = [
    pytest.mark.browser,
    pytest.mark.skipif(missing_browser() is not None, reason=missing_browser() or ""),
    pytest.mark.filterwarnings("default"),
]
TOWN = Path(__file__).resolve().parents[2] / "examples" / "hilly_town"
ROWS_OF = """
const heads = [...document.querySelectorAll(".sf-figures thead th")];
const head = heads.find(one => one.textContent.trim() === arguments[0]);
const rows = [...head.closest("table").querySelectorAll("tbody tr")];
return rows.map(row => [...row.children].map(cell => cell.textContent.trim()));
"""
"""The cells of the table of figures with this head."""


@pytest.fixture(scope="module")
def idle(folder: Path) -> Iterator[Service]:
    """A service without vehicles, to plan with."""
    made = Service(folder, SPEEDUP)
    yield made
    made.stop()


def test_before_anything_flies_the_page_says_what_to_do(page: Page, idle: Service) -> None:
    page.open(idle.url)
    page.see(".sf-overlay h2", "No operation yet")
    page.see(".sf-fleet .sf-empty", "No vehicle is registered")
    for label in ("PAUSE", "HOLD ALL", "RTL ALL", "LAND ALL"):
        assert not page.button(label).is_enabled()
    page.press("Make a plan")
    page.see('nav a[aria-current="page"]', "Plan")


@pytest.mark.parametrize("path", ["/ui/", "/ui/plan", "/ui/drill", "/ui/replay"])
def test_every_control_has_a_name_and_is_reached_by_keyboard(page: Page, idle: Service, path: str) -> None:
    page.open(idle.url, path)
    page.until(lambda: page.unreachable_controls() == [], f"names and tab stops: {page.unreachable_controls()}", 10)


@pytest.mark.parametrize("component", ["map.js", "fleet.js"])
def test_a_component_takes_what_comes_before_it_is_there_and_after_it_has_gone(
    page: Page, idle: Service, component: str
) -> None:
    drawn, moved = sketch(EXAMPLES["minimal"]().model_dump(mode="json"))
    calls: dict[str, list[list[Any]]] = {
        "map.js": [["set_scene", drawn, {}], ["set_frame", moved], ["select", "uav-1"]],
        "fleet.js": [["set_rows", []], ["select", "uav-1"]],
    }
    page.open(idle.url)
    page.see(".sf-fleet .sf-empty", "No vehicle is registered")
    assert stray_errors(page, component, calls[component]) == []


def test_a_plan_is_made_weighed_compared_and_exported(page: Page, idle: Service, folder: Path) -> None:
    page.open(idle.url, "/ui/plan")
    page.see(".sf-sub", "3 UAVs, 9 users")
    page.press("Plan it")
    page.see(".sf-figures th", "Jain index")
    page.press("Draw the curve")
    page.until(lambda: page.points(".sf-curve") >= 8, "eight plans on the trade-off curve")
    page.press("Show")
    page.see(".sf-figures thead th", "other")
    page.until(lambda: page.map_says("lost") == "uav-1", "a ghost")
    page.run("document.querySelector('.sf-work > .sf-scroll').scrollTop = 0")
    page.shot("plan")
    page.press("Export .plan")
    saved = page.until(lambda: next(iter(folder.glob("*.plan")), None), "the download")
    assert json.loads(saved.read_text())["fileType"] == "Plan"


def test_pins_are_set_kept_by_the_plan_and_its_replan_and_released(page: Page, idle: Service) -> None:
    page.open(idle.url, "/ui/plan")
    page.see(".sf-sub", "3 UAVs, 9 users")
    page.choose("UAV to pin", "uav-2")
    page.press("Hover")
    page.choose("User to pin", "user-7")
    page.choose("to UAV", "uav-3")
    page.press("Pin")
    page.see(".sf-pins", "uav-2 hovers at its start")
    page.see(".sf-pins", "user-7 is served by uav-3")
    page.press("Plan it")
    page.see(".sf-sub", "Pinned: uav-2, user-7")
    page.choose("UAV to pin", "uav-1")
    page.press("Keep path")
    page.see(".sf-pins", "uav-1 flies a given path")
    page.reload()
    page.see(".sf-pins", "uav-1 flies a given path")
    page.press("release user-7")
    page.press("Plan it")
    page.see(".sf-sub", "Pinned: uav-1, uav-2")
    page.choose("Lose", "uav-1")
    page.press("Show")
    page.see(".sf-sub", "server, UAVs fly")
    page.see(".sf-sub", "Pin of uav-1 dropped: 'uav-1' is lost")
    page.type("Separation, m", "400")  # more than uav-1, on its path, keeps from uav-2, which hovers
    page.see(".sf-fail", "min_separation_m")
    assert not page.button("Plan it").is_enabled()


def test_a_plan_is_explained_with_how_each_number_was_obtained(page: Page, idle: Service) -> None:
    page.open(idle.url, "/ui/plan")
    page.see(".sf-sub", "3 UAVs, 9 users")
    page.choose("User to pin", "user-1")
    page.choose("to UAV", "uav-3")
    page.press("Pin")
    page.press("Plan it")
    page.see(".sf-sub", "Pinned: user-1")
    page.press("Explain")
    page.see(".sf-reasons h2", "Why the plan is as it is")
    users = page.see('.sf-reasons [aria-label="Users"]').text
    assert all(f"user-{n}" in users for n in range(1, 10))
    assert "pins of the plan" in users
    worth = page.see('.sf-reasons [aria-label="What it would be worth"]').text
    assert all(what in worth for what in ("one more UAV", "10 % more band", "another start"))
    assert all(how in worth for how in ("at most", "planned", "first order"))
    assert "bandwidth" in page.see('.sf-reasons [aria-label="Constraints that bind"]').text
    page.shot("reasons")
    page.press("Close")
    page.until(lambda: not page.text(".sf-reasons h2"), "the dialog gone")


def test_users_and_uavs_are_placed_by_click_and_broken_rules_are_named(page: Page, idle: Service) -> None:
    page.open(idle.url, "/ui/plan")
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


def test_a_scenario_file_is_loaded_and_a_bad_one_refused(page: Page, idle: Service, folder: Path) -> None:
    good, bad = folder / "minimal.json", folder / "bad.json"
    good.write_text(EXAMPLES["minimal"]().model_dump_json())
    bad.write_text("{}")
    page.open(idle.url, "/ui/plan")
    page.see(".sf-sub", "3 UAVs, 9 users")
    page.upload(bad)
    page.see(".sf-fail", "bad.json: origin: Field required")
    page.upload(good)
    page.see(".sf-sub", "2 UAVs, 4 users")


def test_a_spreadsheet_of_users_is_loaded_and_a_plan_exported_as_a_map(page: Page, idle: Service, folder: Path) -> None:
    users, comma = folder / "users.csv", folder / "comma.csv"
    users.write_text("kind,id,lat,lon\nuser,kiosk,47.3990,8.5473\nuser,school,47.4008,8.5502\n")
    comma.write_text("kind;id;lat;lon\nuser;kiosk;47,3990;8.5473\n")
    page.open(idle.url, "/ui/plan")
    page.see(".sf-sub", "3 UAVs, 9 users")
    page.upload(comma)
    page.see(".sf-fail", "comma.csv: row 2: lat: '47,3990' has a decimal comma; write 47.3990")
    page.upload(users)
    page.see(".sf-sub", "3 UAVs, 2 users")
    page.press("Plan it")
    page.see(".sf-figures th", "Jain index")
    page.press("Export map")
    saved = page.until(lambda: next(iter(folder.glob("*.geojson")), None), "the download")
    kinds = {one["properties"]["kind"] for one in json.loads(saved.read_text())["features"]}
    assert {"user", "uav", "path", "position"} <= kinds


def test_the_hilly_town_is_loaded_from_its_files_and_shows_ground_altitudes_and_energy(
    page: Page, idle: Service, folder: Path
) -> None:
    page.open(idle.url, "/ui/plan")
    page.see(".sf-sub", "3 UAVs, 9 users")
    page.upload(*(TOWN / name for name in ("users.csv", "town.geojson", "ground.tif")))
    page.see(".sf-sub", "3 UAVs, 13 users, ground 529 to 654 m above sea level")
    page.press("Plan it")
    page.see(".sf-figures th", "altitude, m above sea level")
    page.see(".sf-figures th", "energy, Wh")
    table = page.driver.execute_script(ROWS_OF, "energy, Wh")
    assert [row[0] for row in table] == ["uav-1", "uav-2", "uav-3"]
    for _, used, left, reserve, spare in table:
        assert float(used) > 0
        assert float(left.split(" ")[0]) >= float(reserve) > 0
        assert float(spare) >= 0
    lowest = [float(row[1]) for row in page.driver.execute_script(ROWS_OF, "altitude, m above sea level")]
    assert min(lowest) >= 529 + 25
    page.driver.save_screenshot(str(folder / "hilly_town.png"))


def test_a_reload_loses_no_scenario_and_no_plan(page: Page, idle: Service) -> None:
    page.open(idle.url, "/ui/plan")
    page.see(".sf-sub", "3 UAVs, 9 users")
    page.press("+ User")
    page.click_map(0.5, 0.55)
    page.see(".sf-sub", "3 UAVs, 10 users")
    page.press("Plan it")
    page.see(".sf-figures th", "Jain index")
    page.reload()
    page.see(".sf-sub", "3 UAVs, 10 users")
    page.see(".sf-figures th", "Jain index")


def test_least_rates_that_cannot_be_met_are_told_and_flown_only_when_asked(
    page: Page, idle: Service, folder: Path
) -> None:
    paper = EXAMPLES["paper"]()
    greedy = (paper.users[0].model_copy(update={"min_rate_bps": 1e9}), *paper.users[1:])
    file = folder / "greedy.json"
    file.write_text(paper.with_changes(users=greedy).model_dump_json())
    page.open(idle.url, "/ui/plan")
    page.see(".sf-sub", "3 UAVs, 9 users")
    page.upload(file)
    page.see(".q-notification", "loaded")
    page.press("Plan it")
    page.see(".sf-figures td", "0-19")
    page.press("Fly it")
    page.see(".sf-flycard .sf-fail", "Below the minimum rate in some slots: user-1")
    assert not page.button("Start: upload, arm, take off").is_enabled()
    page.press("Cancel")


def test_a_drill_without_a_simulated_fleet_begins_nothing(page: Page, idle: Service) -> None:
    page.open(idle.url, "/ui/drill")
    page.until(lambda: page.button("Start the drill").is_enabled(), "the form")
    page.press("Start the drill")
    page.see(".q-notification", "No simulated fleet")
    assert idle.call("GET", "/v1/operations")["items"] == []


def test_a_viewer_signs_in_sees_and_may_not_plan(page: Page, folder: Path) -> None:
    url, key = key_for(folder, "viewer")
    service = Service(folder, SPEEDUP, "--database-url", url)
    try:
        page.driver.get(f"{service.url}/")
        page.see("h1", "skyfolio")
        page.driver.find_element(By.ID, "k").send_keys(key)
        page.press("Sign in")
        page.see(".sf-overlay h2", "No operation yet")
        page.open(service.url, "/ui/plan")
        page.see(".sf-sub", "3 UAVs, 9 users")
        page.press("Plan it")
        page.see(".q-notification", "this needs a planner")
    finally:
        page.leave()
        service.stop()
