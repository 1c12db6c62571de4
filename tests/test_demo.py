"""The demonstration drill as a user runs it: processes, sockets, REST, ground truth."""

import json
import re
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

pytestmark = pytest.mark.e2e
SPEEDUP = 3.0
LATE_S = 1.0
"""By so many wall seconds a loaded machine may be late."""


def fly(out: Path, *options: str) -> tuple[int, dict[str, Any]]:
    command = [sys.executable, "-m", "skyfolio", "demo", "--json", "--speedup", f"{SPEEDUP:g}", "--out", str(out)]
    command += options
    done = subprocess.run(command, capture_output=True, text=True, timeout=280)
    assert done.stdout.startswith("{"), done.stderr
    report: dict[str, Any] = json.loads(done.stdout)
    return done.returncode, report


@pytest.mark.long
def test_with_the_loop_the_survivors_truly_fly_a_new_plan_and_users_get_more(tmp_path: Path) -> None:
    with ThreadPoolExecutor() as both:  # at once: flights mostly wait
        flying = both.submit(fly, tmp_path / "with"), both.submit(fly, tmp_path / "without", "--no-replan")
    (status, with_loop), (status_without, without) = (one.result() for one in flying)
    assert status == 0, [check for check in with_loop["checks"] if not check["passed"]]
    assert with_loop["passed"]
    assert len(with_loop["plans"]) >= 2, "and more where base stations are late, too"
    assert 4.0 <= with_loop["detection_s"] <= 6.0 + LATE_S * SPEEDUP
    assert json.loads((tmp_path / "with" / "report.json").read_text()) == with_loop
    page = (tmp_path / "with" / "report.html").read_text()
    assert page.count("<svg") == 2
    assert not re.search(r"<script|<link|src=|url\(http|href=.http", page), "the page needs nothing but itself"

    assert status_without == 0, [check for check in without["checks"] if not check["passed"]]
    assert len(without["plans"]) == 1
    assert without["flown"]["unserved_after"], "nobody serves the lost UAV's users"
    assert with_loop["flown"]["unserved_after"] == []
    assert with_loop["flown"]["worst_user_after_bps"] > 1000 > without["flown"]["worst_user_after_bps"]
    assert with_loop["flown"]["utility_bps"] > without["flown"]["utility_bps"]
    assert with_loop["flown"]["jain"] > without["flown"]["jain"]
    assert with_loop["slots_without_service"] < without["slots_without_service"]
