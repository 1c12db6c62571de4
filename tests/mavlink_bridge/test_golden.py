"""Whole missions as files: a change of the compiler shows as a change of what vehicles are given.

After a change that is meant, write them anew: `python -m tests.mavlink_bridge.test_golden`.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from skyfolio.mavlink_bridge import Autopilot, OnEnd, compile_mission, to_waypoints
from tests.mavlink_bridge.conftest import plan_of

GOLDEN = Path(__file__).parent / "golden"
PATH = [(0.0, 0.0), (20.0, 0.0), (42.0, 0.0), (42.0, 0.0), (42.0, 0.0), (42.0, 15.0), (60.0, 15.0), (78.0, 15.0)]
CASES = {
    f"{autopilot.value}-{where}": (autopilot, where == "air", on_end)
    for autopilot in Autopilot
    for where, on_end in (("ground", OnEnd.LAND), ("air", OnEnd.RETURN), ("hold", OnEnd.HOLD))
}


def written(name: str) -> str:
    autopilot, airborne, on_end = CASES[name]
    return to_waypoints(
        compile_mission(plan_of({"uav-1": PATH}), "uav-1", airborne=airborne, on_end=on_end, autopilot=autopilot)
    )


@pytest.mark.parametrize("name", CASES)
def test_the_mission_is_the_one_on_file(name: str) -> None:
    assert written(name) == (GOLDEN / f"{name}.waypoints").read_text(encoding="utf-8")


if __name__ == "__main__":
    for case in CASES:
        (GOLDEN / f"{case}.waypoints").write_text(written(case), encoding="utf-8")
