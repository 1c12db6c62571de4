"""Example bodies of the OpenAPI description: built from the planner's own examples."""

from __future__ import annotations

from typing import Any

from skyfolio.planner import EXAMPLES, Utility


def _bodies(**examples: tuple[str, Any]) -> dict[str, Any]:
    bodies = {name: {"summary": summary, "value": value} for name, (summary, value) in examples.items()}
    return {"requestBody": {"content": {"application/json": {"examples": bodies}}}}


PLAN_EXAMPLES = _bodies(
    minimal=("Two UAVs, four users, four slots", EXAMPLES["minimal"]().model_dump(mode="json", exclude_defaults=True)),
    paper=("The letter's scenario", EXAMPLES["paper"]().model_dump(mode="json", exclude_defaults=True)),
    pinned=(
        "uav-1 hovers at its start, and uav-2 serves user-4",
        {
            **EXAMPLES["minimal"]().model_dump(mode="json", exclude_defaults=True),
            "pins": {"uavs": ["uav-1"], "associations": {"user-4": "uav-2"}},
        },
    ),
)
REPLAN_EXAMPLES = _bodies(
    loss=("uav-2 is lost from slot 2 on", {"failed": ["uav-2"], "at_slot": 2}),
    moved=(
        "uav-1 is not at its planned position (metres east, north)",
        {"failed": ["uav-2"], "at_slot": 2, "positions_m": {"uav-1": [51.0, 48.5]}},
    ),
    users=(
        "A user leaves, one joins, and rates are to be steadier",
        {
            "at_slot": 2,
            "users_left": ["user-1"],
            "users_joined": [{"id": "user-5", "position_m": [70.0, 40.0]}],
            "utility": {"kind": "sum", "mu_per_kbps": -0.1},
        },
    ),
    returned=(
        "uav-2 is back, at its present position, with half of its bandwidth",
        {"at_slot": 3, "returned": [{"id": "uav-2", "start_m": [80.0, 60.0]}], "bandwidth_hz": {"uav-2": 5000.0}},
    ),
    little=(
        "A user leaves; uav-1 keeps its path, and other changes must be worth 5 kbit/s each",
        {
            "at_slot": 2,
            "users_left": ["user-1"],
            "pins": {"uavs": ["uav-1"]},
            "keep_pins": True,
            "disruption_weight": 5.0,
        },
    ),
)
PREVIEW_EXAMPLES = _bodies(
    changes=(
        "What would be lost without uav-2 from slot 2 on",
        {"plan_id": "plan-5b0c4e9a7d21", "changes": {"failed": ["uav-2"], "at_slot": 2}},
    ),
    scenario=(
        "The plan's scenario with another utility, from its first slot on",
        {
            "plan_id": "plan-5b0c4e9a7d21",
            "scenario": EXAMPLES["minimal"]()
            .with_changes(utility=Utility(kind="pooled", mu_per_kbps=-0.1))
            .model_dump(mode="json", exclude_defaults=True),
        },
    ),
)
ROBUSTNESS_EXAMPLES = _bodies(
    default=("Default disturbances, every single and double loss half way", {}),
    windy=(
        "A windy day, single losses at two slots, and an outage below 1 kbit/s",
        {
            "disturbances": {"draws": 100, "wind_mps": 10.0, "gust_mps": 3.0},
            "losses": {"at_once": 1, "at_slots": [1, 2]},
            "outage_bps": 1000.0,
        },
    ),
)
IMPORT_EXAMPLES = _bodies(
    users=(
        "Users from a spreadsheet, UAVs and settings of an example",
        {
            "files": [
                {"name": "users.csv", "content": "id,lat_deg,lon_deg\nkiosk,47.3981,8.5463\nschool,47.3984,8.5471\n"}
            ],
            "base": EXAMPLES["minimal"]().model_dump(mode="json", exclude_defaults=True),
        },
    ),
)
VEHICLE_EXAMPLES = _bodies(first=("UAV 'uav-1' is MAVLink system 1", {"uav_id": "uav-1", "system_id": 1}))
OPERATION_EXAMPLES = _bodies(
    auto=("Recover from losses automatically", {"plan_id": "plan-5b0c4e9a7d21", "replanning": "auto"}),
    steady=(
        "A recovery's change must be worth 5 kbit/s for each user that changes UAVs",
        {"plan_id": "plan-5b0c4e9a7d21", "disruption_weight": 5.0},
    ),
    approve=("Ask before missions are swapped", {"plan_id": "plan-5b0c4e9a7d21", "replanning": "approve"}),
)
DRILL_EXAMPLES = _bodies(
    kill=("uav-3 crashes when slot 11 begins", {"operation_id": "op-5b0c4e9a7d21", "uav_id": "uav-3", "at_slot": 11})
)
