"""The dashboard in a real headless Chromium beside a flight: a loss, an operator's commands, a drill, its replay."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from skyfolio.planner import EXAMPLES
from tests.dashboard.stack import SPEEDUP, Page, Service, missing_browser

pytestmark = [
    pytest.mark.browser,
    pytest.mark.long,
    pytest.mark.skipif(missing_browser() is not None, reason=missing_browser() or ""),
    pytest.mark.filterwarnings("default"),
]
PATIENT = {"SKYFOLIO_HEARTBEAT_STALE_S": "4", "SKYFOLIO_HEARTBEAT_LOST_S": "8"}
"""Two wall seconds until a UAV is declared lost: a loaded machine must not lose one by itself."""
LOST = "uav-3"


@pytest.fixture
def flying(folder: Path) -> Iterator[Service]:
    """A service with a simulated fleet of its own; a fleet that has lost a UAV is not used again."""
    made = Service(folder, SPEEDUP / 2, "--simulate", "paper", **PATIENT)
    yield made
    made.stop()


@pytest.fixture
def drilled(folder: Path) -> Iterator[Service]:
    """The same, slow enough for an operator on a loaded machine who is asked before too little is left to fly."""
    patient = {"SKYFOLIO_HEARTBEAT_STALE_S": "3", "SKYFOLIO_HEARTBEAT_LOST_S": "6"}
    made = Service(folder, SPEEDUP / 4, "--simulate", "paper", **patient)
    yield made
    made.stop()


def slot_of(page: Page) -> int:
    words = page.text(".sf-slotno").split()
    return int(words[-1]) if words and words[-1].isdigit() else -1


def fair(folder: Path) -> Path:
    """The letter's scenario, with something for every user and so long that a loaded machine is in time, as a file."""
    paper = EXAMPLES["paper"]()
    users = tuple(user.model_copy(update={"min_rate_bps": 2_000.0}) for user in paper.users)
    file = folder / "fair.json"
    file.write_text(paper.with_changes(users=users, slots=3 * paper.slots).model_dump_json())
    return file


def plan_and_fly(page: Page, service: Service, folder: Path, after_a_loss: str) -> None:
    """As an operator does it: the Plan page, a scenario file, the dialog, and back on the live map."""
    page.open(service.url, "/ui/plan")
    page.see(".sf-sub", "3 UAVs, 9 users")
    page.upload(fair(folder))
    page.see(".sf-sub", "3 UAVs, 9 users")
    page.see(".q-notification", "loaded")
    page.press("Plan it")
    page.see(".sf-figures th", "Jain index")
    page.press("Fly it")
    if after_a_loss != "replan and fly it":
        page.choose("When a UAV is lost", after_a_loss)
    page.press("Start: upload, arm, take off")
    page.see(".sf-what", "FLYING")


def test_an_operation_is_paused_loses_a_uav_recovers_and_is_held(flying: Service, page: Page, folder: Path) -> None:
    plan_and_fly(page, flying, folder, "replan and fly it")
    page.until(lambda: slot_of(page) >= 1, "slot 1")
    assert page.map_says("uavs") == "3"
    page.shot("fly")
    page.keys("SHIFT+P")
    page.see(".sf-what", "PAUSED")
    page.press("RESUME")
    page.see(".sf-what", "FLYING")
    operation = flying.call("GET", "/v1/operations")["items"][0]["id"]
    flying.call("POST", "/v1/drills", json={"operation_id": operation, "uav_id": LOST, "fault": "kill"})
    page.see(f'tr[data-uav="{LOST}"][data-lost="true"]', "LOST")
    page.see('[data-kind="uav_lost"]', f"{LOST} declared LOST")
    page.until(lambda: page.map_says("lost") == LOST, "the ghost")
    for step in ("Loss detected", "Replan", "Upload", "Verified on board", "Survivors fly the new plan"):
        page.see(".sf-tx .sf-steps", step)
    page.see(".sf-tx .sf-change", "server, UAVs fly")
    page.see(".sf-stats", "after replan")
    page.shot("loss")
    page.keys("SHIFT+P")  # nothing that follows is a race with the end of the flight
    page.see(".sf-what", "PAUSED")
    page.run("document.querySelector('.sf-scrub [tabindex]').focus()")
    page.keys("ARROW_LEFT", 3)
    page.until(lambda: page.button("LIVE").get_attribute("aria-pressed") == "false", "the past")
    page.press("LIVE")
    page.prefer("dark")
    page.open(flying.url)
    page.see(".sf-tx .sf-steps", "Survivors fly the new plan")
    page.shot("loss-dark")
    page.resize(820, 1180)
    page.shot("loss-tablet")
    page.resize(1280, 800)
    page.press("RTL ALL")
    page.see(".q-dialog h2", "Return the whole fleet home?")
    page.press("Keep flying")
    page.until(lambda: not page.text(".q-dialog h2"), "the dialog gone")
    page.keys("SHIFT+H")
    page.see(".sf-what", "ABORTED")
    modes = {row["uav_id"]: row["mode"] for row in flying.call("GET", "/v1/fleet/vehicles")}
    assert {mode for uav, mode in modes.items() if uav != LOST} == {"hold"}
    page.press("LAND ALL")  # the operation is over, the fleet is not
    page.see(".q-dialog h2", "Land the whole fleet?")
    page.run("document.querySelector('.sf-confirm-land').click()")
    page.until(
        lambda: all(row["mode"] == "land" for row in flying.call("GET", "/v1/fleet/vehicles") if row["uav_id"] != LOST),
        "everybody landing",
    )


def test_a_drill_is_approved_reported_and_replayed(drilled: Service, page: Page, folder: Path) -> None:
    page.open(drilled.url, "/ui/drill")
    page.see(".sf-panel", "When this slot begins")
    page.type("When this slot begins", "2")
    page.choose("When a UAV is lost", "replan, then ask me")
    page.press("Start the drill")
    page.see(".sf-panel", f"kill of {LOST} when slot 2 begins: struck")
    page.open(drilled.url)
    page.see(".sf-decide", "fly the new plan from slot")
    page.see(".sf-decide .sf-figures", "if approved")
    page.shot("approve")
    page.press("Approve")
    page.see(".sf-tx .sf-steps", "Survivors fly the new plan")
    page.open(drilled.url, "/ui/drill")
    page.see(".sf-report", f"Recovered: {LOST} was lost")
    page.shot("drill")
    page.press("Save the report (HTML)")
    report = page.until(lambda: next(iter(folder.glob("drill-*.html")), None), "the download").read_text()
    assert report.count("<svg") == 2
    assert "<script" not in report
    replay(page, drilled)


def replay(page: Page, service: Service) -> None:
    page.open(service.url, "/ui/replay")
    page.see(".sf-fleet .sf-state", "RECORDED")
    assert page.map_says("lost") == ""
    page.choose("Speed", "20 times")
    page.press("Play")
    page.until(lambda: page.map_says("lost") == LOST, "the loss again")
    page.see(".sf-events .alarm", f"{LOST} declared LOST")
    page.see(".sf-tx .sf-steps", "Survivors fly the new plan")
    page.shot("replay")
