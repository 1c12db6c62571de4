"""How the page keeps up with 50 UAVs and 200 users: `python -m tests.dashboard.responsiveness`, figures as JSON."""

from __future__ import annotations

import json
import re
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from skyfolio.planner import EXAMPLES, Scenario, Uav, User
from tests.api.flying import FleetThread
from tests.dashboard.stack import Page, Service

OBSERVE = """
window.seen = {long: [], raf: 0, began: performance.now(), frames: +document.querySelector(".sf-map").dataset.frames};
new PerformanceObserver((list) => seen.long.push(...list.getEntries().map((e) => e.duration)))
  .observe({type: "longtask"});
(function tick() { seen.raf += 1; requestAnimationFrame(tick); })();
"""
REPORT = """
const s = window.seen, seconds = (performance.now() - s.began) / 1000;
return {seconds, map_frames_hz: (+document.querySelector(".sf-map").dataset.frames - s.frames) / seconds,
  screen_hz: s.raf / seconds, long_tasks: s.long.length, longest_task_ms: Math.max(0, ...s.long),
  busy_share: s.long.reduce((a, b) => a + b, 0) / 1000 / seconds};
"""
CLICK = """
const done = arguments[0], row = document.querySelectorAll(".sf-fleet tbody tr")[7], began = performance.now();
row.click();
requestAnimationFrame(() => requestAnimationFrame(() => done(performance.now() - began)));
"""


def many(uavs: int = 50, users: int = 200) -> Scenario:
    """A grid of UAVs over users drawn uniformly."""
    rng = np.random.default_rng(3)
    starts = [(100.0 + 180 * (n % 10), 100.0 + 180 * (n // 10)) for n in range(uavs)]
    people = [(round(float(rng.uniform(0, 1900)), 1), round(float(rng.uniform(0, 1000)), 1)) for _ in range(users)]
    return EXAMPLES["paper"]().with_changes(
        area_m=((0.0, 0.0), (1900.0, 1000.0)),
        slots=4,
        slot_duration_s=30.0,
        uavs=tuple(Uav(id=f"uav-{n}", start_m=at, max_speed_mps=5.0) for n, at in enumerate(starts, 1)),
        users=tuple(User(id=f"user-{n}", position_m=at) for n, at in enumerate(people, 1)),
    )


def late(service: Service) -> int:
    """How often the service's event loop was kept busy for over 50 ms, by its own metrics."""
    text = service.client.get("/metrics").text
    within, total = (
        int(float(re.search(rf"event_loop_lag_seconds_{what} (\S+)", text)[1]))  # type: ignore[index]
        for what in (r'bucket\{le="0\.05"\}', "count")
    )
    return total - within


def measure(folder: Path, watch_s: float = 20.0) -> dict[str, Any]:
    """Fly 50 UAVs in real time and look at the page for a while."""
    scenario = many()
    service = Service(folder, 1.0)
    vehicles = FleetThread(scenario, service.endpoint, 1.0)
    page = Page(folder)
    try:
        body = scenario.model_dump(mode="json")
        plan = service.call("POST", "/v1/plans", json=body, params={"wait_s": 60, "deadline_s": 20})
        while plan["status"] in {"queued", "running"}:
            plan = service.call("GET", f"/v1/plans/{plan['id']}", params={"wait_s": 60})
        for system_id, uav in enumerate(scenario.uavs, 1):
            service.call("POST", "/v1/fleet/vehicles", json={"uav_id": uav.id, "system_id": system_id})
        page.open(service.url)
        operation = service.call("POST", "/v1/operations", json={"plan_id": plan["id"], "replanning": "off"})
        while operation["state"] not in {"flying", "failed"}:
            time.sleep(0.5)
            operation = service.call("GET", f"/v1/operations/{operation['id']}")
        assert operation["state"] == "flying", operation["error"]
        page.see(".sf-what", "FLYING")
        already_late = late(service)
        page.run(OBSERVE)
        time.sleep(watch_s)
        report: dict[str, Any] = page.run(REPORT)
        report["event_loop_over_50_ms"] = late(service) - already_late
        report["click_to_screen_ms"] = page.driver.execute_async_script(CLICK)
        asked = time.monotonic()
        service.call("GET", "/health")
        report["service_answer_ms"] = (time.monotonic() - asked) * 1e3
        page.driver.save_screenshot(str(folder / "fifty.png"))
        report["screenshot"] = str(folder / "fifty.png")
        return report
    finally:
        page.close()
        service.stop()
        vehicles.stop()


if __name__ == "__main__":
    sys.stdout.write(json.dumps(measure(Path(tempfile.mkdtemp())), indent=2) + "\n")
