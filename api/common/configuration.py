"""Checks of the configuration before anything starts: errors name the setting, in one line, exit status 2."""

from __future__ import annotations

import difflib
import os
import socket
import tempfile
from collections.abc import Collection, Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import ValidationError
from pydantic_settings import SettingsError

from skyfolio.api.common import extras
from skyfolio.api.common.errors import InvalidError
from skyfolio.api.common.settings import NESTED, PREFIX, SET_ELSEWHERE, Settings
from skyfolio.api.common.validation import broken_rules
from skyfolio.mavlink_bridge import Signing
from skyfolio.mavlink_bridge.errors import SigningKeyInvalid

if TYPE_CHECKING:
    from skyfolio.planner import Scenario
    from skyfolio.sim import FieldKnobs, TruthChannel

OF_COMMANDS = frozenset({"SERVICE", "KEY", "SIM_SIGNING_KEY", "API"})
"""Variables that are not settings: of `fly`, `status` and `drill`, of `simulate`, of the tour of the API."""


def settings_from(options: Mapping[str, Any], environment: Mapping[str, str] | None = None) -> Settings:
    """Return the settings from arguments and environment. Raises InvalidError and pydantic's ValidationError."""
    require_known(os.environ if environment is None else environment)
    try:
        return Settings(**options)
    except SettingsError as error:
        raise InvalidError(f"{PREFIX}*: {error}: not JSON") from error


def require_known(environment: Mapping[str, str]) -> None:
    """Refuse variables that nothing reads. Raises InvalidError with the name that was probably meant."""
    known = _variables()
    unknown = [name for name in sorted(environment) if name.upper().startswith(PREFIX) and name.upper() not in known]
    if unknown:
        raise InvalidError("; ".join(_not_known(name, known) for name in unknown))


def require_usable(settings: Settings) -> None:
    """Refuse what cannot work: key file, folder of logs, example, Dask that is not installed.

    Raises InvalidError and MissingExtraError naming the setting.
    """
    if settings.signing_key_file is not None:
        try:
            Signing.from_file(settings.signing_key_file)
        except SigningKeyInvalid as error:
            raise InvalidError(f"signing_key_file: {error}") from error
    if settings.telemetry_log_dir is not None:
        _require_writable("telemetry_log_dir", settings.telemetry_log_dir)
    if settings.scheduler is not None:
        extras.require_all("sweep", "solver: Dask")
    if settings.simulate is not None:
        simulated_scenario(settings.simulate)
    simulated_channel(settings.simulate_channel)
    simulated_field(settings)


def simulated_channel(text: str) -> TruthChannel:
    """Return how the true channel of the simulated fleet differs. Raises InvalidError naming the setting."""
    from skyfolio.sim import channel_from  # noqa: PLC0415 - other commands do without it

    try:
        return channel_from(text)
    except ValueError as error:
        raise InvalidError(f"simulate_channel: {error}") from error


def simulated_field(settings: Settings) -> FieldKnobs:
    """Return what happens around the simulated fleet. Raises InvalidError naming the setting."""
    from skyfolio.sim import field_from  # noqa: PLC0415 - other commands do without it

    try:
        return field_from(
            crew=settings.simulate_crew,
            turnaround_s=settings.simulate_turnaround_s,
            packs=settings.simulate_packs,
            battery_minutes=settings.simulate_battery_minutes,
            fronts=[text for text in settings.simulate_fronts.split(";") if text.strip()],
        )
    except (TypeError, ValueError) as error:
        raise InvalidError(f"simulate_packs, simulate_fronts: {error}") from error


def simulated_scenario(named: str) -> Scenario:
    """Return the scenario whose fleet is simulated: an example, or that in a file `*.json`.

    Raises InvalidError naming the setting when there is none, or what is wrong in the file.
    """
    from skyfolio.planner import EXAMPLES, Scenario  # noqa: PLC0415 - other commands do without them

    if named in EXAMPLES:
        return EXAMPLES[named]()
    if not named.endswith(".json"):
        known = ", ".join(sorted(EXAMPLES))
        raise InvalidError(
            f"simulate: {named!r} must be one of {known}, or a scenario in a file whose name ends in .json"
        )
    try:
        return Scenario.model_validate_json(Path(named).read_bytes())
    except OSError as error:
        raise InvalidError(f"simulate: {named}: {error.strerror or error}") from error
    except ValidationError as error:
        first = broken_rules(error.errors(), ())[0]
        raise InvalidError(f"simulate: {named}: {first['field']}: {first['message']}") from error


def bound(settings: Settings) -> socket.socket:
    """Return the socket of the service, bound and not listening yet.

    Raises InvalidError when the address cannot be bound.
    """
    family = socket.AF_INET6 if ":" in settings.host else socket.AF_INET
    listener = socket.socket(family, socket.SOCK_STREAM)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((settings.host, settings.port))
    except OSError as error:
        listener.close()
        raise InvalidError(f"host, port: {settings.host}:{settings.port} cannot be bound: {error.strerror}") from error
    listener.set_inheritable(True)
    return listener


def _variables() -> set[str]:
    names = {PREFIX + name for name in OF_COMMANDS}
    for name, field in Settings.model_fields.items():
        names.add(PREFIX + name.upper())
        kind = field.annotation
        if isinstance(kind, type) and is_dataclass(kind):
            names |= {f"{PREFIX}{name.upper()}{NESTED}{part.name.upper()}" for part in fields(kind)}
    return names


def _not_known(name: str, known: Collection[str]) -> str:
    part = name.rpartition(".")[2]
    if "." in name and part in SET_ELSEWHERE:
        meant = [PREFIX + SET_ELSEWHERE[part].upper()]
    else:
        meant = difflib.get_close_matches(name.upper().replace(".", NESTED), sorted(known), n=1)
    return f"{name}: is not a setting of skyfolio" + (f"; did you mean {meant[0]}?" if meant else "")


def _require_writable(field: str, folder: Path) -> None:
    """Refuse a folder that cannot be created or written. Raises InvalidError naming the setting."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise InvalidError(f"{field}: nothing can be written to {folder}: {error.strerror}") from error
