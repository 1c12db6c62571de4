"""`bench scale`: what is calculated from figures, what is said to limit a sweep, and the command in its quick form."""

import json
import re
import subprocess
import sys
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import pytest

from skyfolio.api.lab.bench.many_areas import Assumed, Measured, demand_of, line_through, measured_of
from skyfolio.api.lab.bench.scale_limits import CORES, ENGINE, IDLE, OTHERS, SLOWER, with_limits
from skyfolio.api.lab.bench.scale_page import markdown, tables

ROOT = Path(__file__).resolve().parents[2]
MEASURED = Measured(
    fixed_share=0.1,
    share_each=0.002,
    subscriber_share=0.002,
    service_mb=200.0,
    worker_mb=824.0,
    telemetry_bytes_per_s_each=440.0,
    telemetry_messages_per_s_each=20.0,
    plan_cpu_s=1.2,
    replan_cpu_s=0.13,
    slot_s=5.0,
    commits_per_s_each_operation=3.0,
    events_per_uav_hour=720.0,
    bytes_per_uav_hour=2e6,
    events_per_s=4000.0,
)


def test_a_hundred_areas_worked_by_hand() -> None:
    found = demand_of(MEASURED, Assumed())
    assert (found.uavs, found.areas_per_service, found.services) == (5000, 3, 34)
    assert found.service_share == pytest.approx(0.1 + 3 * (50 * 0.002 + 10 * 0.002)), "four areas would be 0.58"
    assert found.telemetry_mbit_s == pytest.approx(40.0), "5000 times 440 bytes and 20 heads of 28 bytes a second"
    assert found.telemetry_mbit_s_each_service == pytest.approx(1.2)
    assert [found.commits_per_s, found.events_per_s] == pytest.approx([300.0, 1000.0])
    assert [found.events_per_day, found.share_of_one_database] == pytest.approx([86.4e6, 0.25])
    assert [found.stored_gb_per_day, found.stored_gb] == pytest.approx([240.0, 21_600.0])
    assert found.dask_normal == 16, "200 plans, every loss ahead each minute, 10 losses: 39,305 s of 2,520 s each"
    assert found.dask_worst_hour == 18, "600 plans, and all of an area ahead again after each of 500 losses: 42,970 s"
    assert found.dask_burst == 3, "120 s of 42 s each"
    assert found.dask_every_slot == 186, "5000 replans in 5 s, 3.5 s of each worker"
    assert found.processes == 2 * 34 + 18
    assert found.cores == 32 + 34 + 18, "34 services of 0.46 at half a core each, their solvers, Dask"
    assert found.memory_gb == pytest.approx(34 + 18 * 824 / 1024)


def test_the_demand_follows_what_is_measured() -> None:
    base = demand_of(MEASURED, Assumed())
    slower = demand_of(replace(MEASURED, replan_cpu_s=0.26), Assumed())
    assert slower.dask_normal > 1.9 * base.dask_normal
    heavier = demand_of(replace(MEASURED, share_each=0.02), Assumed())
    assert (heavier.services, heavier.areas_per_service) == (100, 1), "an area is not shared between services"
    assert heavier.service_share > 1.0, "and it is said that it does not fit one core"
    assert demand_of(MEASURED, Assumed(areas=1, uavs=5)).services == 1


@pytest.mark.parametrize(
    ("assumed", "message"),
    [
        (Assumed(areas=0), "areas: 0 must be more than 0"),
        (Assumed(subscribers=-1), "subscribers: -1 must be at least 0"),
        (Assumed(workers_filled=1.5), r"workers_filled: 1\.5 must be at most 1"),
        (Assumed(uavs=251), "uavs: 251 of one area are more than one link carries"),
    ],
)
def test_assumptions_that_make_no_sense_are_refused_by_name(assumed: Assumed, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        demand_of(MEASURED, assumed)


def test_a_line_is_drawn_through_the_shares_of_fleets() -> None:
    assert [*line_through([(10, 0.3), (20, 0.5), (30, 0.7)])] == pytest.approx([0.1, 0.02])
    assert [*line_through([(50, 0.5)])] == pytest.approx([0.0, 0.01])
    steep = line_through([(10, 0.1), (50, 0.9)])
    assert [*steep] == pytest.approx([0.0, 1 / 60]), "a service without UAVs takes no less than nothing"


def row(cores: int, cases_per_s: float, cpu_ms: float, engine: float, others: float, idle: float) -> dict[str, Any]:
    shares = {"engine_share": engine, "others_share": others, "idle_share": idle}
    return {"cores": cores, "cases_per_s": cases_per_s, "cpu_ms_per_case": cpu_ms, **shares}


@pytest.mark.parametrize(
    ("second", "limit"),
    [
        (row(2, 19.0, 100.0, 0.02, 0.02, 0.01), CORES),
        (row(2, 10.0, 100.0, 0.02, 0.02, 0.46), IDLE),
        (row(2, 7.0, 250.0, 0.05, 0.05, 0.02), SLOWER),
        (row(2, 6.0, 100.0, 0.60, 0.05, 0.05), ENGINE),
        (row(2, 6.0, 100.0, 0.05, 0.60, 0.05), OTHERS),
    ],
)
def test_what_limits_a_sweep_is_named_from_where_the_core_seconds_went(second: dict[str, Any], limit: str) -> None:
    first = row(1, 9.5, 100.0, 0.03, 0.01, 0.01)
    found = with_limits([first, second])
    assert found[0]["limit"] == CORES
    assert found[1]["limit"] == limit
    assert found[1]["speedup"] == pytest.approx(second["cases_per_s"] / 9.5)
    assert found[1]["used"] == pytest.approx(second["cases_per_s"] * 0.1 / 2)


@pytest.mark.long
@pytest.mark.e2e
def test_the_quick_form_shows_every_part_and_nothing_is_lost(tmp_path: Path) -> None:
    page = tmp_path / "scale.md"
    command = [sys.executable, "-m", "skyfolio", "bench", "scale", "--quick", "--json", "--page", str(page)]
    ran = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert ran.returncode == 0, ran.stderr
    figures = json.loads(ran.stdout)
    assert page.read_text() == markdown(figures)
    assert len(tables(figures)) == 10
    sweep, service = figures["sweep"], figures["service"]
    for one in (sweep["alone"], *sweep["pool"], *sweep["strong"], *sweep["weak"]):
        assert one["cases"] == 8
        assert one["cpu_ms_per_case"] > 0
    assert sum(figures["killed"][name] for name in ("lost", "doubled")) == 0
    assert figures["killed"]["killed"] == 1
    assert figures["killed"]["recomputed"] * figures["killed"]["cases"] <= 16, "what two batches hold at most"
    assert figures["stopped"]["lost"] == 0
    assert [(one["vehicles"], one["heard"]) for one in service["bridge"]] == [(2, 2), (3, 3)]
    assert all(one["bytes_per_s"] > 10 * one["messages_per_s"] > 0 for one in service["bridge"])
    assert [(one["subscribers"], one["events_lost"]) for one in service["streams"]] == [(3, 0)]
    assert [(one["database"], one["stored"]) for one in service["events"]] == [("SQLite", 50)]
    assert service["flights"][0]["commits_per_s"] > 0
    needed = demand_of(measured_of(figures), Assumed())
    assert figures["many"] == {"assumed": asdict(Assumed()), "needed": asdict(needed)}


FIGURES: dict[str, Any] = {
    "area": {"plan_cpu_s": 1.2, "replan_cpu_s": 0.13, "slot_s": 5.0, "peak_mb": 824.0},
    "service": {
        "bridge": [
            {"vehicles": 50, "share_of_one_core": 0.05, "bytes_per_s": 1.0, "messages_per_s": 1.0},
            {"vehicles": 200, "share_of_one_core": 0.2, "bytes_per_s": 440.0, "messages_per_s": 20.0},
        ],
        "flying": [
            {"vehicles": 10, "share_of_one_core": 0.12, "memory_mb": 150.0},
            {"vehicles": 50, "share_of_one_core": 0.2, "memory_mb": 190.0},
        ],
        "streams": [{"vehicles": 50, "subscribers": 100, "share_of_one_core": 0.4, "memory_mb": 200.0}],
        "flights": [{"commits_per_s": 3.0, "events_per_uav_hour": 720.0, "bytes_per_uav_hour": 2e6}],
        "events": [{"per_s": 9000.0}, {"per_s": 4000.0}],
    },
}


def test_what_the_calculation_needs_is_taken_from_the_figures_of_the_whole_service_in_flight() -> None:
    assert asdict(measured_of(FIGURES)) == pytest.approx(asdict(MEASURED))
    without = {**FIGURES, "service": {**FIGURES["service"], "flying": []}}
    assert measured_of(without).share_each == pytest.approx(0.001), "of the link alone where no service was flown"


def test_the_calculation_in_the_documentation_runs(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    (code,) = re.findall(r"^```python\n(import json.*?)^```$", (ROOT / "docs/scaling.md").read_text(), re.M | re.S)
    (tmp_path / "docs" / "benchmarks").mkdir(parents=True)
    (tmp_path / "docs" / "benchmarks" / "scale.json").write_text(json.dumps(FIGURES))
    monkeypatch.chdir(tmp_path)
    exec(code, {})  # noqa: S102 - our own page
    assert capsys.readouterr().out.startswith("Demand(uavs=1000, ")


def test_the_page_in_the_documentation_is_that_of_its_figures() -> None:
    for file in (ROOT / "docs" / "benchmarks").glob("scale.json"):
        figures = json.loads(file.read_text())
        assert file.with_suffix(".md").read_text() == markdown(figures)
        needed = demand_of(measured_of(figures), Assumed(**figures["many"]["assumed"]))
        assert figures["many"]["needed"] == asdict(needed)
