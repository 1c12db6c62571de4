"""What is wrong with the set-up is said at start, by name, in one line, with exit status 2 and without a traceback."""

import socket
from pathlib import Path

import pytest

from skyfolio.api.cli.main import main
from skyfolio.api.common.configuration import bound, require_known, require_usable, settings_from, simulated_scenario
from skyfolio.api.common.errors import InvalidError
from skyfolio.api.common.settings import Settings
from skyfolio.api.fleet.simulated_fleet import weather_of
from skyfolio.api.http.routes.deps import require_within_limits
from skyfolio.mavlink_bridge.conditions import Timing
from skyfolio.planner import EXAMPLES
from skyfolio.planner.areas.size import is_large
from skyfolio.planner.layouts import laid_out
from skyfolio.planner.scenario import Wind
from tests.ports import free_port


@pytest.mark.parametrize(
    ("wrong", "meant"),
    [
        ("SKYFOLIO_PROT", "SKYFOLIO_PORT"),
        ("SKYFOLIO_HEARTBEAT_LOST", "SKYFOLIO_HEARTBEAT_LOST_S"),
        ("SKYFOLIO_SIGNING_KEY", "SKYFOLIO_SIM_SIGNING_KEY"),
        ("skyfolio_databaseurl", "SKYFOLIO_DATABASE_URL"),
        ("SKYFOLIO_TIMING.proof_s", "SKYFOLIO_TIMING__PROOF_S"),
        ("SKYFOLIO_TIMING__PROOF", "SKYFOLIO_TIMING__PROOF_S"),
        ("SKYFOLIO_TIMING.lost_after_s", "SKYFOLIO_HEARTBEAT_LOST_S"),
        ("SKYFOLIO_TIMING.stale_after_s", "SKYFOLIO_HEARTBEAT_STALE_S"),
    ],
)
def test_a_misspelt_variable_is_refused_with_the_one_that_was_meant(wrong: str, meant: str) -> None:
    with pytest.raises(InvalidError, match=rf"^{wrong}: is not a setting of skyfolio; did you mean {meant}\?$"):
        settings_from({}, {wrong: "1", "HOME": "/"})


def test_a_variable_like_no_other_is_refused_without_a_guess_and_all_are_named() -> None:
    with pytest.raises(InvalidError) as refused:
        require_known({"SKYFOLIO_XYZZY_QQQQ": "", "SKYFOLIO_PROT": ""})
    assert "SKYFOLIO_PROT: " in str(refused.value)
    assert "SKYFOLIO_XYZZY_QQQQ: is not a setting of skyfolio" in str(refused.value)


def test_every_setting_and_what_the_commands_read_is_known() -> None:
    names = [f"SKYFOLIO_{name.upper()}" for name in Settings.model_fields]
    require_known(
        dict.fromkeys([*names, "SKYFOLIO_SERVICE", "SKYFOLIO_KEY", "SKYFOLIO_TIMING__PROOF_S", "skyfolio_port"], "")
    )


def test_a_field_of_a_setting_can_be_set_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SKYFOLIO_TIMING", '{"proof_s": 4, "clear_after_s": 2}')
    monkeypatch.setenv("SKYFOLIO_TIMING__PROOF_S", "9")
    assert Settings().timing == Timing(proof_s=9, clear_after_s=2)


@pytest.mark.parametrize("field", ["lost_after_s", "stale_after_s"])
def test_what_has_a_setting_of_its_own_is_not_ignored_elsewhere(monkeypatch: pytest.MonkeyPatch, field: str) -> None:
    setting = f"SKYFOLIO_HEARTBEAT_{field.split('_', maxsplit=1)[0].upper()}_S"
    for name, value in ((f"SKYFOLIO_TIMING__{field.upper()}", "4"), ("SKYFOLIO_TIMING", f'{{"{field}": 4}}')):
        monkeypatch.setenv(name, value)
        with pytest.raises(ValueError, match=setting):
            Settings()
        monkeypatch.delenv(name)
    with pytest.raises(ValueError, match=setting):
        Settings(timing=Timing(**{field: 4.5}))


def test_a_port_that_is_taken_is_named() -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        with pytest.raises(
            InvalidError, match=rf"^host, port: 127\.0\.0\.1:{port} cannot be bound: Address already in use"
        ):
            bound(Settings(port=port))


def test_an_address_that_is_not_of_this_machine_is_named() -> None:
    with pytest.raises(InvalidError, match=r"^host, port: 192\.0\.2\.1:8080 cannot be bound: "):
        bound(Settings(host="192.0.2.1"))
    with pytest.raises(InvalidError, match=r"^host, port: nowhere\.invalid:8080 cannot be bound: "):
        bound(Settings(host="nowhere.invalid"))


@pytest.mark.parametrize("host", ["127.0.0.1", "::1", "localhost"])
def test_a_port_that_is_free_is_bound_and_nobody_is_let_wait_at_it(host: str) -> None:
    port = free_port(socket.SOCK_STREAM)
    with bound(Settings(host=host, port=port)) as made:
        assert made.getsockname()[1] == port
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection((made.getsockname()[0], port))


@pytest.mark.parametrize("content", [None, b"", b"short", b"x" * 64, b"a" * 33])
def test_a_key_file_of_no_use_is_named_and_not_shown(tmp_path: Path, content: bytes | None) -> None:
    file = tmp_path / "signing.key"
    if content is not None:
        file.write_bytes(content)
    with pytest.raises(InvalidError, match=r"^signing_key_file: ") as refused:
        require_usable(Settings(signing_key_file=file))
    assert not content or content.decode() not in str(refused.value)


def test_a_folder_that_takes_no_files_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InvalidError, match=r"^telemetry_log_dir: nothing can be written to "):
        require_usable(Settings(telemetry_log_dir=tmp_path / "file" / "logs"))
    require_usable(Settings(telemetry_log_dir=tmp_path / "new" / "logs"))


@pytest.mark.parametrize(
    ("variables", "said"),
    [
        ({"SKYFOLIO_PROT": "1"}, "SKYFOLIO_PROT: is not a setting of skyfolio; did you mean SKYFOLIO_PORT?"),
        ({"SKYFOLIO_PORT": "x"}, "port: "),
        ({"SKYFOLIO_TIMING": "{"}, "timing"),
        ({"SKYFOLIO_TIMING": '{"lost_after_s": 9}'}, "timing: lost_after_s is not set here but by heartbeat_lost_s"),
        ({"SKYFOLIO_SIGNING_KEY_FILE": "/none/key"}, "signing_key_file: signing key: /none/key"),
        ({"SKYFOLIO_TELEMETRY_LOG_DIR": "/dev/null/logs"}, "telemetry_log_dir: "),
        ({"SKYFOLIO_DATABASE_URL": "sqlite+aiosqlite:////dev/null/x.db"}, "database_url: "),
        ({"SKYFOLIO_HOST": "192.0.2.1"}, "host, port: 192.0.2.1:"),
        ({"SKYFOLIO_SIMULATE": "papr"}, "simulate: 'papr' must be one of"),
        ({"SKYFOLIO_SIMULATE_CHANNEL": "bias_db=x"}, "simulate_channel: bias_db must be a number, got 'x'"),
        ({"SKYFOLIO_SIMULATE_PACKS": "count=3"}, "simulate_packs, simulate_fronts: packs: nobody changes them"),
        ({"SKYFOLIO_SIMULATE_FRONTS": "at_s=5;at_s=x"}, "at_s must be a number, got 'x'"),
        ({"SKYFOLIO_ROOT_PATH": "sky"}, "root_path: "),
        ({"SKYFOLIO_TRUSTED_PROXIES": "nginx"}, "trusted_proxies: "),
        ({"SKYFOLIO_ALLOWED_HOSTS": "*"}, "allowed_hosts: "),
    ],
)
def test_serve_ends_with_status_two_and_one_line(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], variables: dict[str, str], said: str
) -> None:
    given = {"SKYFOLIO_DATABASE_URL": "temporary", "SKYFOLIO_PORT": str(free_port(socket.SOCK_STREAM))} | variables
    for name, value in given.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr("sys.argv", ["skyfolio", "serve", "--no-ui"])
    with pytest.raises(SystemExit) as ended:
        main()
    printed = capfd.readouterr()
    assert ended.value.code == 2
    assert printed.out == ""
    assert said in printed.err
    assert len(printed.err.strip().splitlines()) == 1


@pytest.mark.parametrize(
    ("command", "wrong", "meant"),
    [
        ("keys list", "SKYFOLIO_DATABSE_URL", "SKYFOLIO_DATABASE_URL"),
        ("simulate --duration-s 0.1", "SKYFOLIO_SIM_SIGNINGKEY", "SKYFOLIO_SIM_SIGNING_KEY"),
        ("status", "SKYFOLIO_SERVCE", "SKYFOLIO_SERVICE"),
    ],
)
def test_no_command_works_elsewhere_than_a_misspelt_variable_means(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], command: str, wrong: str, meant: str
) -> None:
    monkeypatch.setenv(wrong, "x")
    monkeypatch.setattr("sys.argv", ["skyfolio", *command.split()])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    assert f"did you mean {meant}?" in capfd.readouterr().err


def test_settings_survive_being_written_as_json() -> None:
    settings = Settings(heartbeat_lost_s=7.0, timing=Timing(proof_s=9))
    assert Settings.model_validate_json(settings.model_dump_json()) == settings


def test_fifty_uavs_a_thousand_users_and_a_hundred_slots_are_accepted_by_default() -> None:
    require_within_limits(laid_out("uniform", 50, 1000, 100, seed=1), Settings())
    with pytest.raises(InvalidError, match="slots: 5,050,000 UAVs x users x slots are more than the 5,000,000"):
        require_within_limits(laid_out("uniform", 50, 1000, 101, seed=1), Settings(max_cells=5_000_000))


def test_a_fleet_that_is_planned_by_areas_is_accepted_by_default() -> None:
    large = laid_out("uniform", 100, 4000, 100, seed=1)
    assert is_large(large)
    require_within_limits(large, Settings())


@pytest.mark.parametrize(
    ("size", "message"),
    [
        ((129, 200, 2), "uavs: 129 UAVs are more than the 128"),
        ((2, 5001, 2), "users: 5,001 users are more than the 5,000"),
        ((2, 4, 2001), "slots: 2,001 slots are more than the 2,000"),
        ((2, 4001, 500), "slots: 2,000,500 users x slots are more than the 2,000,000"),
        ((120, 4200, 100), "slots: 50,400,000 UAVs x users x slots are more than the 50,000,000"),
    ],
)
def test_what_is_too_large_is_named_with_its_limit(size: tuple[int, int, int], message: str) -> None:
    with pytest.raises(InvalidError, match=f"{message} that this service plans at once; `skyfolio plan` has no limit"):
        require_within_limits(laid_out("uniform", *size, seed=1), Settings())


def test_the_fleet_of_a_scenario_in_a_file_is_simulated_in_its_wind(tmp_path: Path) -> None:
    file = tmp_path / "windy.json"
    windy = EXAMPLES["minimal"]().with_changes(wind=Wind(east_mps=2.0, gust_mps=1.5))
    file.write_text(windy.model_dump_json())
    assert simulated_scenario(str(file)) == windy
    weather = weather_of(windy)
    assert weather is not None
    assert (weather.wind_east_mps, weather.wind_north_mps, weather.gust_mps) == (2.0, 0.0, 0.5)
    assert weather_of(EXAMPLES["minimal"]()) is None


@pytest.mark.parametrize(
    ("named", "content", "said"),
    [
        ("nowhere", None, "simulate: 'nowhere' must be one of .* whose name ends in .json"),
        ("none.json", None, "simulate: .*none.json: No such file"),
        ("half.json", '{"slots": 3}', "simulate: .*half.json: "),
    ],
)
def test_a_fleet_that_cannot_be_simulated_is_refused_by_name(
    tmp_path: Path, named: str, content: str | None, said: str
) -> None:
    file = tmp_path / named
    if content is not None:
        file.write_text(content)
    with pytest.raises(InvalidError, match=said):
        simulated_scenario(str(file) if named.endswith(".json") else named)
