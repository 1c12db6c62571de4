"""What the command line tells of itself: help with examples and units, version, completion, progress, banner."""

from __future__ import annotations

import os
import pty
import re
import shlex
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from skyfolio import __version__
from skyfolio.api.cli import main as cli
from skyfolio.api.cli.examples import EXAMPLES
from skyfolio.api.cli.lazy import COMPLETION, load
from skyfolio.api.common.settings import Settings
from skyfolio.api.http.banner import banner
from tests.api.test_cli import run
from tests.ports import free_port

UNIT = re.compile(
    r"\b(seconds|minutes|metres|m/s|kbit/s|dBm?|Hz|degrees|Wh|real time|share|gap|index|speed-up)\b",
    re.IGNORECASE,
)
"""Units, and words for numbers that have none."""


def walked(name: str, command: Any) -> Iterator[tuple[str, Any]]:
    parts = getattr(command, "commands", None)
    if not parts:
        yield name, command
        return
    for part, of_group in parts.items():
        yield from walked(f"{name} {part}", of_group)


def every_command() -> dict[str, Any]:
    return dict(found for name, lazy in cli.COMMANDS.items() for found in walked(name, load(name, lazy)))


def test_the_help_of_every_command_ends_with_an_example_that_it_would_take() -> None:
    commands = every_command()
    assert set(EXAMPLES) == set(commands)
    for name, command in commands.items():
        example = EXAMPLES[name]
        assert example.startswith(f"skyfolio {name}"), name
        context = command.make_context(name, shlex.split(example.split(" > ")[0])[1 + len(name.split()) :])
        shown = command.get_help(context)
        assert shown.endswith(f"Example:\n    {example}"), name


def test_every_option_of_a_fractional_number_says_its_unit() -> None:
    said = {
        f"{name} {option.name}": option.help or ""
        for name, command in every_command().items()
        for option in command.params
        if "float" in str(getattr(option, "type_descriptor", option))
    }
    assert len(said) > 20
    assert {name: text for name, text in said.items() if not UNIT.search(text)} == {}


def test_the_version_is_that_of_the_package(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(monkeypatch, "--version") == 0
    assert capsys.readouterr().out == f"skyfolio {__version__}\n"


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish", "powershell"])
def test_the_script_of_a_shell_asks_this_command(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], shell: str
) -> None:
    assert run(monkeypatch, "completion", shell) == 0
    script = capsys.readouterr().out
    assert f"{COMPLETION}=complete_{shell}" in script.replace("Env:", "").replace(' = "', "=")


@pytest.mark.parametrize(
    ("typed", "offered"),
    [
        ("skyfolio fl", ["fleet", "fly"]),
        ("skyfolio fleet re", ["register", "return"]),
        ("skyfolio plan --me", ["--method"]),
        ("skyfolio completion b", ["bash"]),
    ],
)
def test_bash_completes_commands_options_and_values(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], typed: str, offered: list[str]
) -> None:
    monkeypatch.setenv(COMPLETION, "complete_bash")
    monkeypatch.setenv("COMP_WORDS", typed)
    monkeypatch.setenv("COMP_CWORD", str(len(typed.split()) - 1))
    assert run(monkeypatch) == 0
    assert capsys.readouterr().out.split() == offered


def planned(stderr: int | None) -> subprocess.CompletedProcess[bytes]:
    command = [sys.executable, "-m", "skyfolio", "plan", "--example", "paper", "--json"]
    return subprocess.run(command, stdout=subprocess.PIPE, stderr=stderr, env={**os.environ, "TERM": "xterm"})


def test_a_terminal_is_shown_the_best_plan_so_far_and_a_file_nothing() -> None:
    ours, theirs = pty.openpty()
    done = planned(theirs)
    os.close(theirs)
    shown = b""
    while part := _read(ours):
        shown += part
    os.close(ours)
    assert done.returncode == 0
    assert re.search(rb"best so far \d+\.\d\d kbit/s", shown)
    assert planned(subprocess.PIPE).stderr == b""


def _read(terminal: int) -> bytes:
    try:
        return os.read(terminal, 65536)
    except OSError:  # how Linux tells that the other end is closed
        return b""


def test_what_is_given_on_the_command_line_is_planned_instead_of_what_the_scenario_says(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from skyfolio.planner import EXAMPLES as SCENARIOS  # noqa: PLC0415
    from skyfolio.planner import Plan, plan  # noqa: PLC0415

    given = ["--utility", "per_user", "--mu", "-0.2", "--noise-dbm", "-85", "--seed", "3", "--starts", "2"]
    assert run(monkeypatch, "plan", "--example", "minimal", *given, "--json") == 0
    made = Plan.model_validate_json(capsys.readouterr().out)
    scenario = SCENARIOS["minimal"]()
    utility = {"kind": "per_user", "mu_per_kbps": -0.2}
    channel = scenario.channel.model_dump() | {"noise_dbm": -85.0}
    changed = scenario.with_changes(utility=scenario.utility.model_dump() | utility, channel=channel)
    assert made.scenario == changed
    assert made.trajectories_m == plan(changed, seed=3, n_starts=2).trajectories_m
    assert run(monkeypatch, "plan", "--example", "minimal", "--method", "static", "--json") == 0
    still = Plan.model_validate_json(capsys.readouterr().out)
    assert {uav: set(path) for uav, path in still.trajectories_m.items()} == {
        uav.id: {uav.start_m} for uav in scenario.uavs
    }


def test_the_banner_names_every_address_and_no_secret() -> None:
    settings = Settings(
        database_url="postgresql+asyncpg://skyfolio:hunter2@db/skyfolio", fleet_url="udpin://127.0.0.1:14540"
    )
    said = banner(settings, "::1", 8081, ui=True)
    assert "dashboard  http://[::1]:8081/ui\n" in said
    assert "REST       http://[::1]:8081/v1, described at http://[::1]:8081/docs\n" in said
    assert "udpin://127.0.0.1:14540" in said
    assert "hunter2" not in said
    assert "off (--no-ui)" in banner(settings, "127.0.0.1", 80, ui=False)
    flown = banner(Settings(simulate="paper", time_scale=5), "127.0.0.1", 80, ui=True)
    assert "the simulated fleet of paper, 5 times real time" in flown


@pytest.mark.e2e
def test_a_service_of_an_own_scenario_says_where_it_is_and_flies_drills_of_it(tmp_path: Path) -> None:
    from skyfolio.planner import EXAMPLES as SCENARIOS  # noqa: PLC0415

    file, port = tmp_path / "own.json", free_port(socket.SOCK_STREAM)
    own = SCENARIOS["minimal"]().with_changes(slots=100, altitude_m=8.0)
    file.write_text(own.model_dump_json())
    command = [sys.executable, "-m", "skyfolio", "serve", "--simulate", str(file), "--port", str(port)]
    command += ["--database-url", "temporary", "--time-scale", "3"]
    asked = {**os.environ, "COLUMNS": "200", "SKYFOLIO_SERVICE": f"http://127.0.0.1:{port}"}
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as service:
        assert service.stderr is not None
        try:
            assert any(f"http://127.0.0.1:{port}/ui" in line for line in service.stderr)
            told = subprocess.Popen(["cat"], stdin=service.stderr, stdout=subprocess.DEVNULL)

            def ask(*arguments: str) -> str:
                done = subprocess.run(
                    [sys.executable, "-m", "skyfolio", *arguments], env=asked, capture_output=True, text=True
                )
                assert done.returncode == 0, done.stderr
                return done.stdout

            ask("fly", str(file))
            operation = re.search(r"op\S*(?=:)", ask("status"))
            assert operation is not None
            said = ask("drill", operation[0], "uav-2")
            assert "kill of uav-2 is " in said
            until = 60
            while "uav-2" not in (seen := ask("status")) or "heartbeat lost at" not in seen:
                until -= 1
                assert until, seen
            assert "simulated" in ask("fleet", "list")
        finally:
            service.send_signal(signal.SIGTERM)
            service.wait(20)
            told.wait(20)
