"""The `skyfolio` command."""

import json
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from skyfolio.api.cli import main as cli
from skyfolio.api.cli.lazy import load
from skyfolio.api.client import Client
from skyfolio.api.common import kernels
from skyfolio.api.flights.operation_views import OperationView, State
from skyfolio.api.flights.orders import OrderResult
from skyfolio.api.flights.recovery_report import HeldPins, RecoveryReport
from skyfolio.planner import (
    EXAMPLES,
    Disruption,
    Disturbances,
    DroppedPin,
    Explanation,
    Losses,
    Pins,
    Plan,
    Robustness,
    Scenario,
    Trial,
    assess,
    explain,
    plan,
    violations,
)
from skyfolio.planner.energy.outlook import landing_of
from skyfolio.planner.scenario import Battery

ROOT = Path(__file__).resolve().parents[2]


def run(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int:
    monkeypatch.setattr(sys, "argv", ["skyfolio", *arguments])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    code = ended.value.code
    return code if isinstance(code, int) else 0


def test_a_demo_that_makes_no_sense_is_refused(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert run(monkeypatch, "demo", "--kill", "uav-9", "--out", str(tmp_path / "out")) == 1
    assert "kill: 'uav-9' must be one of uav-1, uav-2, uav-3" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_plan_prints_a_feasible_plan_as_json(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(monkeypatch, "plan", "--example", "minimal", "--json") == 0
    made = Plan.model_validate_json(capsys.readouterr().out)
    assert violations(made) == []
    assert made.scenario == EXAMPLES["minimal"]()


def test_plan_shows_a_table_without_json(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(monkeypatch, "plan", "--example", "minimal") == 0
    assert "mean sum rate" in capsys.readouterr().out


def test_plan_shows_how_uavs_with_a_battery_come_home(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    minimal, scenario, file = EXAMPLES["minimal"](), tmp_path / "scenario.json", tmp_path / "plan.json"
    full = minimal.uavs[0].model_copy(update={"battery": Battery(usable_wh=60.0)})
    scenario.write_text(minimal.with_changes(uavs=(full, *minimal.uavs[1:])).model_dump_json())
    monkeypatch.setenv("COLUMNS", "200")
    assert run(monkeypatch, "plan", str(scenario)) == 0
    shown = capsys.readouterr().out
    assert run(monkeypatch, "plan", str(scenario), "--json", "--out", str(file)) == 0
    landing = landing_of(Plan.model_validate_json(file.read_text()), "uav-1")
    assert landing is not None
    row = next(line for line in shown.split("left at home")[1].splitlines() if "uav-1" in line)
    told = f"{landing.home_wh:.1f} ({landing.home_wh / 60.0:.0%})"
    assert [cell.strip() for cell in row.strip("│ ").split("│")] == [
        "uav-1", f"{landing.used_wh:.1f}", told, "12.0", f"{landing.spare_wh:.1f}",
    ]  # fmt: skip
    assert "uav-2" not in shown.split("left at home")[1]  # it has none


def test_replan_and_export_take_the_file_that_plan_wrote(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    scenario, file, again = tmp_path / "scenario.json", tmp_path / "plan.json", tmp_path / "sub" / "again.json"
    scenario.write_text(EXAMPLES["minimal"]().model_dump_json())
    assert run(monkeypatch, "plan", str(scenario), "--json", "--out", str(file)) == 0
    arguments = ["replan", str(file), "--failed", "uav-1", "--at-slot", "2", "--json", "--out", str(again)]
    assert run(monkeypatch, *arguments) == 0
    made = Plan.model_validate_json(again.read_text())
    assert made.first_slot == 2
    assert set(made.trajectories_m) == {"uav-2"}
    capsys.readouterr()
    assert run(monkeypatch, "export", str(again)) == 0
    assert json.loads(capsys.readouterr().out)["fileType"] == "Plan"
    assert run(monkeypatch, "export", str(file), "--format", "waypoints", "--uav-id", "uav-2") == 0
    assert capsys.readouterr().out.startswith("QGC WPL 110")
    assert run(monkeypatch, "export", str(again), "--autopilot", "ardupilot") == 0
    assert json.loads(capsys.readouterr().out)["mission"]["firmwareType"] == 3


def test_robustness_is_that_of_the_planner_and_shows_users_losses_and_the_worst(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    file, out = tmp_path / "plan.json", tmp_path / "robustness.json"
    assert run(monkeypatch, "plan", "--example", "minimal", "--json", "--out", str(file)) == 0
    capsys.readouterr()
    asked = ["--draws", "20", "--wind-mps", "9", "--at-slot", "1", "--at-slot", "2", "--outage-kbps", "1"]
    asked += ["--pushed-s", "0.4", "--noise-s", "60", "--most", "5", "--outage-share", "0.8"]
    assert run(monkeypatch, "robustness", str(file), *asked, "--json") == 0
    found = Robustness.model_validate_json(capsys.readouterr().out)
    trial = Trial(
        disturbances=Disturbances(draws=20, wind_mps=9.0, pushed_s=0.4, position_noise_s=60.0),
        losses=Losses(at_slots=(1, 2), most=5),
        outage_share=0.8,
        outage_bps=1000.0,
    )
    assert found == assess(Plan.model_validate_json(file.read_text()), trial)
    assert run(monkeypatch, "robustness", str(file), *asked, "--out", str(out)) == 0
    assert Robustness.model_validate_json(out.read_text()) == found
    shown = " ".join(capsys.readouterr().out.split())
    assert "From a loss on" in shown
    assert "20 draws; an outage is less than 1000 bit/s in a slot" in shown
    assert "worst double loss: uav-1, uav-2" in shown
    assert run(monkeypatch, "robustness", str(file), "--at-slot", "9") == 2
    assert "losses.at_slots: 9 must lie in 0..3" in capsys.readouterr().err


def test_explain_tells_why_from_the_file_that_plan_wrote(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    file, out = tmp_path / "plan.json", tmp_path / "why.json"
    assert run(monkeypatch, "plan", "--example", "minimal", "--json", "--out", str(file)) == 0
    capsys.readouterr()
    assert run(monkeypatch, "explain", str(file), "--json") == 0
    made = Plan.model_validate_json(file.read_text())
    found = Explanation.model_validate_json(capsys.readouterr().out)
    assert found == explain(made)
    assert run(monkeypatch, "explain", str(file), "--resolves", "0", "--out", str(out)) == 0
    assert Explanation.model_validate_json(out.read_text()).resolves == 0
    shown = capsys.readouterr().out
    assert "What it would be worth" in shown
    assert "Which constraints bind" in shown
    assert "bounds and derivatives only" in " ".join(shown.split())


def test_replan_takes_changes_from_a_file(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    file, changes = tmp_path / "plan.json", tmp_path / "changes.json"
    changes.write_text('{"users_left": ["user-1"], "bandwidth_hz": {"uav-2": 5000.0}}')
    assert run(monkeypatch, "plan", "--example", "minimal", "--json", "--out", str(file)) == 0
    capsys.readouterr()
    assert run(monkeypatch, "replan", str(file), "--changes", str(changes), "--at-slot", "2", "--json") == 0
    made = Plan.model_validate_json(capsys.readouterr().out)
    assert made.scenario.user_ids == ("user-2", "user-3", "user-4")
    assert made.scenario.uav("uav-2").bandwidth_hz == 5000.0


def test_plan_and_replan_take_pins_from_a_file_and_replan_a_price(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    file, pins = tmp_path / "plan.json", tmp_path / "pins.json"
    pins.write_text('{"uavs": ["uav-1"]}')
    assert run(monkeypatch, "plan", "--example", "minimal", "--pins", str(pins), "--json", "--out", str(file)) == 0
    made = Plan.model_validate_json(file.read_text())
    assert set(made.trajectories_m["uav-1"]) == {made.scenario.uav("uav-1").start_m}
    capsys.readouterr()
    weighed = ["--failed", "uav-2", "--at-slot", "1", "--pins", str(pins), "--disruption-weight", "3", "--json"]
    assert run(monkeypatch, "replan", str(file), *weighed) == 0
    again = Plan.model_validate_json(capsys.readouterr().out)
    assert list(again.pins.paths_m) == ["uav-1"]
    assert again.disruption is not None
    assert again.disruption.weight_kbps == 3.0
    assert run(monkeypatch, "replan", str(file), "--at-slot", "1", "--pins", str(pins), "--json") == 0
    assert Plan.model_validate_json(capsys.readouterr().out).scenario.uav_ids == ("uav-1", "uav-2")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["plan"], "one of them"),
        (["fall"], "No such command 'fall'"),
        (["drill"], "OPERATION_ID: is missing; see "),
        (["plan", "--example", "minimal", "--bogus"], "--bogus: there is no such option; see "),
        (["plan", "--example", "minimal", "--mu", "1"], "--mu: Input should be less than or equal to 0"),
        (["plan", "--example", "minimal", "--utility", "joy"], "utility.kind: "),
        (["plan", "--example", "minimal", "--noise-dbm", "900"], "channel.noise_dbm: Input should be less than"),
        (["plan", "--example", "minimal", "--method", "magic"], "method: 'magic' must be one of fast, areas"),
        (["plan", "--example", "minimal", "--method", "static", "--pins", "{held}"], "pins: only the method 'fast'"),
        (["plan", "--example", "none"], "must be one of"),
        (["plan", "/no/such/file"], "No such file"),
        (["replan", "{plan}", "--failed", "uav-9", "--at-slot", "1"], "failed: 'uav-9' is not a UAV"),
        (["replan", "{plan}", "--at-slot", "1"], "give --failed UAV or --changes FILE"),
        (["replan", "{plan}", "--at-slot", "1", "--changes", "{plan}"], "Extra inputs are not permitted"),
        (["explain", "{bad}"], "bad.json: "),
        (["plan", "--example", "minimal", "--pins", "{plan}"], "Extra inputs are not permitted"),
        (["plan", "--example", "minimal", "--pins", "{pins}"], "pins.uavs: 'uav-9' is not a UAV of the plan"),
        (
            ["replan", "{plan}", "--failed", "uav-1", "--at-slot", "1", "--disruption-weight", "inf"],
            "disruption_weight",
        ),
        (["export", "{plan}", "--format", "waypoints"], "choose one of uav-1, uav-2"),
        (["plan", "{bad}"], "bad.json: uavs.0.bandwidth_hz: Input should be greater than or equal to 1"),
        (["plan", "--example", "minimal", "--out", "/dev/null/plan.json"], "--out: /dev/null/plan.json: "),
    ],
)
def test_a_mistake_is_one_message_and_status_2(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    arguments: list[str],
    said: str,
) -> None:
    files = {name: tmp_path / f"{name[1:-1]}.json" for name in ("{plan}", "{bad}", "{pins}", "{held}")}
    files["{held}"].write_text('{"uavs": ["uav-1"]}')
    files["{pins}"].write_text('{"uavs": ["uav-9"]}')
    run(monkeypatch, "plan", "--example", "minimal", "--json", "--out", str(files["{plan}"]))
    bad: dict[str, Any] = EXAMPLES["minimal"]().model_dump(mode="json")
    bad["uavs"][0]["bandwidth_hz"] = -5
    files["{bad}"].write_text(json.dumps(bad))
    capsys.readouterr()
    assert run(monkeypatch, *(str(files.get(one, one)) for one in arguments)) == 2
    printed = capsys.readouterr()
    assert said in " ".join(printed.err.split())
    assert all(line.startswith("error: ") for line in printed.err.splitlines())
    assert printed.out == ""


def test_keys_are_made_listed_and_revoked_and_shown_only_once(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    where = ["--database-url", f"sqlite+aiosqlite:///{tmp_path}/service.db", "--json"]
    assert run(monkeypatch, "keys", "create", "ground station", "--role", "pilot", *where) == 0
    made = json.loads(capsys.readouterr().out)
    assert made["role"] == "pilot"
    assert run(monkeypatch, "keys", "list", *where) == 0
    listed = capsys.readouterr().out
    assert made["key"].split("_", 2)[2] not in listed
    [row] = json.loads(listed)
    assert (row["name"], row["role"], row["revoked_at"]) == ("ground station", "pilot", None)
    assert run(monkeypatch, "keys", "revoke", row["id"], *where) == 0
    capsys.readouterr()
    assert run(monkeypatch, "keys", "list", *where) == 0
    assert json.loads(capsys.readouterr().out)[0]["revoked_at"] > 0
    assert run(monkeypatch, "keys", "revoke", "none", *where) == 2
    assert "does not exist" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["serve", "--host", "0.0.0.0"], "there is no API key"),  # noqa: S104
        (["serve", "--database-url", "mysql://x"], "must be 'temporary'"),
        (["serve", "--port", "0", "--database-url", "temporary", "--time-scale", "0"], "time_scale: "),
        (["status", "--service", "http://127.0.0.1:9"], "nothing answers at http://127.0.0.1:9"),
        (["fly", "--example", "none"], "must be one of"),
        (["fleet", "fall"], "No such command 'fall'"),
        (["fleet", "hold", "--force"], "--force: there is no such option"),
        (["fleet", "register", "uav-1", "256"], "SYSTEM_ID: Input should be less than or equal to 255"),
        (["fleet", "list", "--service", "http://127.0.0.1:9"], "nothing answers at http://127.0.0.1:9"),
        (["fleet", "land", "--service", "http://127.0.0.1:9"], "nothing answers at http://127.0.0.1:9"),
    ],
)
def test_a_service_that_cannot_be_run_or_reached_is_one_message(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    arguments: list[str],
    said: str,
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    assert run(monkeypatch, *arguments) == 2
    assert said in " ".join(capsys.readouterr().err.split())


def test_fly_passes_pins_and_weight_and_tells_what_a_recovery_changed(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    asked: dict[str, Any] = {}
    dropped = DroppedPin(kind="path", id="uav-2", slots=3, reason="'uav-2' is lost")
    report = RecoveryReport(
        outcome="flying",
        lost={"uav-2": 5.0},
        declared_at_s=7.0,
        at_slot=3,
        plan_id="plan-2",
        disruption=Disruption(
            user_slots_changed=6, users_changed=2, path_changed_m=31.4, weight_kbps=5.0, price_bps=9_000.0
        ),
        pins=HeldPins(uavs=["uav-1"], users=[], dropped=(dropped,)),
    )
    view = OperationView(
        id="op-1", version=1, state=State.FLYING, replanning="auto", plan_id="plan-2", plan_ids=["plan-1", "plan-2"],
        vehicles={}, uavs={}, lost=["uav-2"], returned=[], elapsed_s=20.0, slot=4, recoveries=[report],
        user_rates_bps={}, error=None,
    )  # fmt: skip

    def plan(_: Client, scenario: Scenario, *, pins: Pins | None = None) -> Any:
        asked.update(scenario=scenario, pins=pins)
        return SimpleNamespace(id="plan-1")

    def fly(_: Client, plan_id: str, **options: Any) -> OperationView:
        asked.update(plan_id=plan_id, **options)
        return view

    monkeypatch.setattr(Client, "plan", plan)
    monkeypatch.setattr(Client, "fly", fly)
    file = tmp_path / "pins.json"
    file.write_text('{"uavs": ["uav-1"]}')
    weighed = ("--pins", str(file), "--disruption-weight", "5")
    assert run(monkeypatch, "fly", "--example", "minimal", *weighed) == 0
    assert (asked["pins"], asked["disruption_weight"]) == (Pins(uavs=("uav-1",)), 5.0)
    said = capsys.readouterr().out
    assert "2 users change server, 31 m off the old paths, priced 9.00 kbit/s" in said
    assert "pins kept: uav-1" in said
    assert "path pin of uav-2 dropped: 'uav-2' is lost" in said
    assert run(monkeypatch, "fly", "--example", "minimal") == 0
    assert asked["disruption_weight"] is None


def test_orders_to_the_fleet_are_told_one_by_one_and_one_that_fails_is_status_1(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    asked: list[tuple[str, list[str] | None, bool]] = []
    outcomes = [OrderResult(uav_id="uav-1", outcome="ok"), OrderResult(uav_id="uav-2", outcome="left_alone")]

    def order(_: Client, action: str, uav_ids: list[str] | None = None, *, force: bool = False) -> list[OrderResult]:
        asked.append((action, uav_ids, force))
        return outcomes

    monkeypatch.setattr(Client, "order", order)
    assert run(monkeypatch, "fleet", "hold") == 0
    assert "left alone" in capsys.readouterr().out
    outcomes.append(OrderResult(uav_id="uav-3", outcome="failed", reason="no answer"))
    assert run(monkeypatch, "fleet", "land", "uav-3", "--force", "--json") == 1
    assert json.loads(capsys.readouterr().out)[2]["reason"] == "no answer"
    assert asked == [("hold", None, False), ("land", ["uav-3"], True)]


def scenario_file(tmp_path: Path, encoding: str = "utf-8", **changes: Any) -> str:
    file = tmp_path / "town.json"
    document = {**EXAMPLES["minimal"]().model_dump(mode="json"), **changes}
    file.write_text(json.dumps(document, ensure_ascii=False), encoding=encoding)
    return str(file)


def test_a_proof_that_a_channel_does_not_allow_is_one_message_that_names_the_field(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = scenario_file(tmp_path, channel={"kind": "los_probability"})
    assert run(monkeypatch, "bound", file) == 2
    assert "error: channel.kind, channel.antenna: " in capsys.readouterr().err
    assert run(monkeypatch, "plan", file, "--json") == 0
    assert json.loads(capsys.readouterr().out)["scenario"]["channel"]["kind"] == "los_probability"


def test_a_file_with_a_byte_order_mark_is_read(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    assert run(monkeypatch, "plan", scenario_file(tmp_path, "utf-8-sig"), "--json") == 0


def test_an_invalid_user_is_one_error_that_names_file_field_and_value(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    file = scenario_file(tmp_path, users=[{"id": "müller", "position_m": [60.0, 200.0]}])
    assert run(monkeypatch, "plan", file) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"error: {file}: users.0.id: 'müller': String should match pattern")


def test_ends_that_cannot_be_flown_to_are_one_error_that_names_the_uavs(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    a, b = (10.0, 2.0), (290.0, 2.0)
    uavs = [{"id": "a", "start_m": a, "end_m": b}, {"id": "b", "start_m": b, "end_m": a}]
    corridor: dict[str, Any] = {
        "area_m": [[0, 0], [300, 4]],
        "min_separation_m": 5.0,
        "slots": 30,
        "slot_duration_s": 4.0,
    }
    file = scenario_file(tmp_path, uavs=uavs, **corridor)
    assert run(monkeypatch, "plan", file) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "'a' and 'b' find no way past each other" in line


def test_a_plan_that_leaves_a_least_rate_unmet_is_written_and_says_whose_with_status_3(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    users = [dict(user) for user in EXAMPLES["minimal"]().model_dump(mode="json")["users"]]
    users[0]["min_rate_bps"] = 1e9
    assert run(monkeypatch, "plan", scenario_file(tmp_path, users=users), "--json") == 3
    printed = capsys.readouterr()
    assert Plan.model_validate_json(printed.out).status == "infeasible"
    assert "user-1 gets less than its min_rate_bps 1e+09 in slots 0-3" in printed.err


HEAVY = {"numpy", "numba", "scipy", "pydantic", "fastapi", "sqlalchemy", "mavsdk", "pymavlink", "planner", "asyncio"}


@pytest.mark.parametrize(
    ("arguments", "allowed"),
    [
        (["--help"], set()),
        (["bench", "--help"], {"pydantic"}),  # typer looks at types with it
        (["serve", "--help"], {"pydantic"}),
        (["plan", "--help"], {"numpy", "numba", "scipy", "pydantic", "planner"}),
    ],
)
def test_help_loads_neither_planner_nor_service(arguments: list[str], allowed: set[str]) -> None:
    look = (
        "import sys\nfrom skyfolio.api.cli.main import cli\n"
        f"try: cli({arguments!r})\nexcept SystemExit: pass\n"
        "print(*{name.split('.')[0] for name in sys.modules}, file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", look], cwd=ROOT, capture_output=True, text=True, check=True)
    assert "Usage" in done.stdout
    assert HEAVY & set(done.stderr.split()) <= allowed


def test_what_help_says_of_a_command_is_the_first_line_of_its_docstring() -> None:
    for name, lazy in cli.COMMANDS.items():
        command = load(name, lazy)
        assert " ".join(command.help.split("\n\n")[0].split()) == lazy.help, name


def test_a_plan_is_only_timed_once_kernels_are_there(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    order: list[str] = []

    def load_all(say: Any) -> int:
        say("compiling")
        order.append("kernels")
        return 1

    def planned(*given: Any, **named: Any) -> Plan:
        order.append("plan")
        return plan(*given, **named)

    monkeypatch.setattr(kernels, "load_all", load_all)
    monkeypatch.setattr("skyfolio.api.cli.planning.plan", planned)
    assert run(monkeypatch, "plan", "--example", "minimal", "--json") == 0
    assert order == ["kernels", "plan"]
    printed = capsys.readouterr()
    assert printed.err == "compiling\n"
    Plan.model_validate_json(printed.out)


def test_warm_up_says_what_it_compiled_and_where(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(monkeypatch, "warm-up") == 0
    capsys.readouterr()
    assert run(monkeypatch, "warm-up", "--json") == 0
    said = json.loads(capsys.readouterr().out)
    assert said["compiled"] == 0
    assert Path(said["folder"]) == kernels.folder()
    assert list(Path(said["folder"]).rglob("climb.climb-*.nbc"))
