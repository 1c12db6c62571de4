"""What tests ask of a service over HTTP, wherever it lives: on sockets, in this process, or in virtual time."""

from __future__ import annotations

from typing import Any

import httpx2

from skyfolio.planner import Scenario


def planned(http: httpx2.Client, scenario: Scenario) -> str:
    """The id of a plan of the scenario, whose UAVs are registered as vehicles 1, 2, ..."""
    for system_id, uav in enumerate(scenario.uav_ids, start=1):
        body = {"uav_id": uav, "system_id": system_id}
        assert http.post("/v1/fleet/vehicles", json=body).status_code == 201
    made = http.post("/v1/plans", params={"wait_s": 60}, json=scenario.model_dump(mode="json")).json()
    while made["status"] in {"queued", "running"}:
        made = http.get(f"/v1/plans/{made['id']}", params={"wait_s": 60}).json()
    return str(made["id"])


def events_of(http: httpx2.Client) -> list[dict[str, Any]]:
    """Every event of a service so far, page by page."""
    found: list[dict[str, Any]] = []
    after: int | None = 0
    while after is not None:
        answer = http.get("/v1/events/log", params={"limit": 500, "after": after})
        assert answer.status_code == 200, answer.text
        page = answer.json()
        found, after = found + page["items"], page["next"]
    return found
