"""Events in an operator's words."""

import pytest

from skyfolio.api.dashboard.event_text import describe
from skyfolio.api.dashboard.views import ServiceEvent


@pytest.mark.parametrize(
    ("kind", "data", "said", "level"),
    [
        ("uav_lost", {"uav_id": "uav-3", "silent_for_s": 5.2}, "uav-3 declared LOST after 5.2 s of silence", "alarm"),
        (
            "uav_lost",
            {"uav_id": "uav-3", "cause": "human_took_over", "detail": "in mode 'position'", "silent_for_s": 0.0},
            "uav-3 declared LOST: human took over (in mode 'position')",
            "alarm",
        ),
        ("solver_moved", {"to": "tcp://10.0.0.2:8786", "because": ""}, "solves go to tcp://10.0.0.2:8786", "ok"),
        (
            "solver_moved",
            {"to": "local workers", "because": "the scheduler went away"},
            "solves go to local workers: the scheduler went away",
            "warn",
        ),
        (
            "fleet_order",
            {
                "action": "hold",
                "vehicles": [
                    {"uav_id": "uav-1", "outcome": "ok"},
                    {"uav_id": "uav-2", "outcome": "failed", "reason": "no answer"},
                ],
            },
            "ordered to hold: uav-1 (not uav-2: no answer)",
            "alarm",
        ),
        (
            "uav_lost",
            {"uav_id": "uav-1", "cause": "ordered", "detail": "told to land by order", "silent_for_s": 0.0},
            "uav-1 left its operation: told to land by order",
            "warn",
        ),
        (
            "condition",
            {"uav_id": "uav-1", "after": "low_battery", "cause": "18% of charge left"},
            "uav-1 low battery: 18% of charge left",
            "warn",
        ),
        ("link", {"uav_id": "uav-3", "before": "live", "after": "stale", "silent_for_s": 3.0}, "stale", "warn"),
        ("operation", {"state": "failed", "error": "no"}, "operation failed: no", "alarm"),
        ("operation", {"state": "link_lost", "error": None}, "our own link is lost", "alarm"),
        (
            "uav_warning",
            {"uav_id": "uav-1", "detail": "said 'GCS Failsafe - Continuing Auto Mode'"},
            "uav-1 reports a failsafe and flies on: said 'GCS Failsafe - Continuing Auto Mode'",
            "warn",
        ),
        (
            "verdict_withdrawn",
            {"uav_id": "uav-2", "verdict": "disarmed_in_air", "because": "armed at 60.0 m"},
            "uav-2 was not disarmed in air: armed at 60.0 m; its air is reserved again",
            "alarm",
        ),
        ("recovery", {"outcome": "flying", "plan_id": "plan-1", "replan_ms": 12.3}, "replanned in 12 ms", "ok"),
        ("recovery", {"outcome": "too_late", "error": "no slot"}, "too late: no slot", "alarm"),
        ("plan_ended", {"plan_id": "plan-1", "status": "failed", "error": "x"}, "plan-1 failed: x", "warn"),
        ("missions_uploaded", {"uavs": 3, "upload_s": 0.02}, "3 missions uploaded and verified in 0.02 s", "ok"),
        (
            "slip",
            {"uav_id": "uav-1", "late_s": 4.2, "distance_m": 12.0, "off_schedule": True},
            "uav-1 is 12.0 m off its plan, 4.2 s behind schedule",
            "warn",
        ),
        (
            "slip",
            {"uav_id": "uav-1", "late_s": None, "distance_m": 6.0, "off_schedule": True},
            "uav-1 is 6.0 m off its plan, where it should hover",
            "warn",
        ),
        ("slip", {"uav_id": "uav-1", "late_s": -0.3, "distance_m": 3.0, "off_schedule": False}, "", ""),
        ("slip", {"uav_id": "uav-1", "late_s": None, "distance_m": 1.1, "off_schedule": False}, "", ""),
        ("preflight", {"uav_id": "uav-1", "level": "blocker", "name": "P", "found": 1, "should": 2}, "P is 1", "alarm"),
        ("guidance_resumed", {"uav_id": "uav-1", "error": None}, "uav-1 is kept on schedule again", "ok"),
        ("guidance_resumed", {"uav_id": "uav-1", "error": "4 items"}, "uav-1 flies on unguided: 4 items", "warn"),
        (
            "speed_restored",
            {"uav_id": "uav-1", "mode": "return", "speed_mps": 5.0, "error": None},
            "uav-1 left the commanded mode (for return) at a commanded speed: its cruise speed of 5 m/s is restored",
            "warn",
        ),
        (
            "speed_restored",
            {"uav_id": "uav-1", "mode": "return", "speed_mps": 5.0, "error": "TIMEOUT"},
            "its cruise speed could not be restored: TIMEOUT",
            "alarm",
        ),
        (
            "stuck",
            {"uav_id": "uav-1", "item": 5, "next_item": 6, "for_s": 4.1, "distance_m": 1.5},
            "uav-1 stayed 1.5 m from item 5 for 4.1 s: sent on to item 6",
            "warn",
        ),
        (
            "altitude_off_plan",
            {"uav_id": "uav-1", "level": "warning", "off_m": -12.0},
            "uav-1 is 12.0 m below its planned altitude",
            "warn",
        ),
        ("altitude_off_plan", {"uav_id": "uav-1", "level": "ok", "off_m": 0.3}, "at its planned altitude again", "ok"),
        ("home_moved", {"uav_id": "uav-1", "moved_m": 9.0, "up_m": 0.5}, "uav-1 has a new home, 9.0 m away", "warn"),
        ("guard", {"level": "warning", "error": "gone"}, "the stream has no guard", "warn"),
        ("lands_instead_of_returning", {"because": "'uav-1' and 'uav-2'"}, "'uav-1' and 'uav-2'", "warn"),
        ("station", {"station": "station-1", "is_dark": True}, "station-1 is dark", "alarm"),
        ("station", {"station": "station-1", "is_dark": False}, "station-1 is manned again", "ok"),
        ("not_called_home", {"uav_id": "uav-1", "error": "timed out"}, "uav-1 has to come home", "alarm"),
        ("brought_down", {"uav_id": "uav-1", "action": "land", "because": "it hovered"}, "uav-1 lands: it hov", "warn"),
        (
            "brought_down",
            {"uav_id": "uav-1", "action": "land", "error": "TIMEOUT"},
            "cannot be brought down: TIMEOUT",
            "alarm",
        ),
        ("wind_changed", {"operation_id": "op-1", "to_mps": 7}, "wind changed to_mps 7", ""),
    ],
)
def test_events_are_described_to_the_operator(kind: str, data: dict[str, object], said: str, level: str) -> None:
    found, worth = describe(ServiceEvent(id=1, at="2030-01-01T00:00:00Z", kind=kind, data=data))
    assert said in found
    assert bool(said) == bool(found)
    assert worth == level
