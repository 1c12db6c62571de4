from __future__ import annotations

import ast
from pathlib import Path
from typing import Any

import pytest

from skyfolio.api.cli.autopilots import DEFAULT
from skyfolio.mavlink_bridge import (
    DEFAULT_AUTOPILOT,
    Autopilot,
    FlightMode,
    FormatError,
    HeartbeatMonitor,
    Mission,
    MissionItem,
    UnknownAutopilot,
    from_qgc_plan,
    to_qgc_plan,
)
from skyfolio.mavlink_bridge.classifier import Classifier
from skyfolio.mavlink_bridge.link import FleetLink
from skyfolio.mavlink_bridge.profiles import PROFILES, profile_in_heartbeat, profile_of, unknown_autopilot
from skyfolio.mavlink_bridge.telemetry import TelemetryState

ROOT = Path(__file__).resolve().parents[2]
AEROB = 16
PX4_MISSION_MODE = 4 << 16 | 4 << 24
NAMES_ONE = {"autopilots.py", "px4.py", "ardupilot.py"}
"""Files that may name an autopilot: the names themselves, the profiles, and the default of the command line."""
PICKS_FLEETS = {"api/lab/bench/bridge_virtual.py", "api/lab/bench/energy.py", "api/lab/torture/aims.py"}
"""Benches list the fleets they measure, drills those that some faults need."""


def heartbeat(autopilot: int, custom_mode: int) -> dict[str, Any]:
    return {"type": 2, "autopilot": autopilot, "base_mode": 157, "custom_mode": custom_mode, "system_status": 4}


def names_an_autopilot(node: ast.AST) -> bool:
    if isinstance(node, ast.Constant):
        return node.value in list(Autopilot)
    return isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "Autopilot"


def test_every_name_has_a_profile_and_every_profile_another_mav_autopilot() -> None:
    assert set(PROFILES) == set(Autopilot)
    assert len({profile.mav_autopilot for profile in PROFILES.values()}) == len(PROFILES)
    for autopilot, profile in PROFILES.items():
        assert profile_of(autopilot) is profile_in_heartbeat(profile.mav_autopilot) is profile


@pytest.mark.parametrize("package", ["mavlink_bridge", "api"])
def test_only_profiles_know_one_autopilot_from_another(package: str) -> None:
    naming = [
        f"{source.relative_to(ROOT)}: {ast.unparse(node)}"
        for source in (ROOT / package).rglob("*.py")
        if source.name not in NAMES_ONE and str(source.relative_to(ROOT)) not in PICKS_FLEETS
        for node in ast.walk(ast.parse(source.read_text()))
        if names_an_autopilot(node)
    ]
    assert naming == []


@pytest.mark.parametrize("profile", PROFILES.values(), ids=lambda profile: profile.title)
def test_a_mode_that_is_commanded_is_ours_or_ends_the_flight(profile: Any) -> None:
    assert {profile.hold_mode, profile.stream_mode} <= set(profile.mode_numbers) & profile.our_modes
    assert set(profile.mode_numbers) - profile.our_modes == {FlightMode.RETURN, FlightMode.LAND}
    with pytest.raises(ValueError, match=f"mode: 'manual' is not one {profile.autopilot} is commanded into"):
        profile.numbers_of(FlightMode.MANUAL)


def test_an_unknown_name_is_refused_with_the_known_ones() -> None:
    assert Autopilot(DEFAULT) is DEFAULT_AUTOPILOT
    with pytest.raises(ValueError, match="autopilot: 'pixhawk' is unknown; known are px4, ardupilot"):
        Autopilot("pixhawk")


def test_an_unknown_autopilot_is_named_and_its_modes_are_not_read_as_px4_has_them() -> None:
    state = TelemetryState(1)
    state.fold("HEARTBEAT", heartbeat(AEROB, PX4_MISSION_MODE), 1.0)
    state.fold("MISSION_CURRENT", {"seq": 3, "total": 9}, 1.0)
    assert (state.mode, state.profile, state.mission_total) == (FlightMode.OTHER, None, None)
    assert not state.is_ours
    assert str(unknown_autopilot(state.mav_autopilot)) == (
        "its autopilot is AEROB (MAV_AUTOPILOT 16); missions are compiled for PX4 or ArduPilot only"
    )
    assert unknown_autopilot(99).autopilot == "UNKNOWN_99 (MAV_AUTOPILOT 99)"


def test_nobody_takes_over_a_vehicle_whose_modes_are_not_known() -> None:
    classifier = Classifier(links=HeartbeatMonitor())
    classifier.watch(1, 0.0)
    for second in range(5):
        classifier.hear(1, 1, "HEARTBEAT", heartbeat(AEROB, PX4_MISSION_MODE), float(second))
    assert classifier.taken(1, 5.0) is None


async def test_a_vehicle_that_was_never_heard_has_neither_an_autopilot_nor_a_model() -> None:
    class Clock:
        def now(self) -> float:
            return 0.0

    async with FleetLink(clock=Clock(), monitor=HeartbeatMonitor()) as link:
        for ask in (link.autopilot, link.model, link.profile):
            with pytest.raises(UnknownAutopilot, match="its autopilot is not heard yet"):
                ask(7)
        assert not link.is_ours(7)


def test_a_plan_file_for_an_unknown_autopilot_is_refused_and_one_for_any_vehicle_read() -> None:
    item = MissionItem(seq=0, frame=6, command=16, current=1, x=473977420, y=85455940, z=60.0)
    plan = to_qgc_plan(Mission(uav_id="uav-1", items=(item,), slot_of_item={0: 0}, duration_s=5.0))
    plan["mission"]["firmwareType"] = AEROB
    with pytest.raises(FormatError, match=r"mission.firmwareType: AEROB \(16\) is not PX4 or ArduPilot"):
        from_qgc_plan(plan)
    plan["mission"]["firmwareType"] = 0
    assert from_qgc_plan(plan) == (item,)
