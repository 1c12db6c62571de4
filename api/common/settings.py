"""Settings of the service: environment variables `SKYFOLIO_*`, or arguments of `skyfolio serve`."""

from __future__ import annotations

import ipaddress
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, field_validator, model_validator
from pydantic_settings import BaseSettings, SettingsConfigDict

from skyfolio.mavlink_bridge.conditions import Timing
from skyfolio.mavlink_bridge.findings import START_WITHIN_M

Seconds = Annotated[float, Field(gt=0)]
Count = Annotated[int, Field(ge=1)]
PREFIX = "SKYFOLIO_"
TEMPORARY = "temporary"
"""Database URL of a service that forgets everything at its end."""
NESTED = "__"
MOST_WEIGHT = 1e9
"""The greatest `disruption_weight`, kbit/s: nothing that can stay changes."""
SUB_PATH = r"(/[A-Za-z0-9._~-]+)*"
SET_ELSEWHERE = {"stale_after_s": "heartbeat_stale_s", "lost_after_s": "heartbeat_lost_s"}
"""Fields of `timing` that have a setting of their own."""


class Settings(BaseSettings):
    """How the service runs. It binds to loopback by default.

    database_url: `sqlite+aiosqlite:///FILE`, `postgresql+asyncpg://...`, or `temporary`, which is deleted at the end.
    time_scale: how much faster than real time the (simulated) fleet lives; leave it at 1 for real aircraft.
    several_services: several services share the PostgreSQL database; each operation belongs to one by a lease.
    lease_s: wall seconds after which a lease that could not be renewed has run out; all services need the same.
    service_name: what others and operators call this service; by default this machine's name and the port.
    fleet_url: where vehicles are; several links, the preferred first, separated by commas. forward_url: udpout://HOST:PORT
    where a ground station watches the fleet; forward_commands: whether it may command too. signing_key_file: 32 bytes
    (or 64 hexadecimal digits); MAVLink is then signed both ways. telemetry_log_dir: one .tlog an operation.
    preflight: whether a blocker of the audit only is an event, or keeps the fleet on the ground. start_within_m: a
    vehicle further than this from its first point keeps the fleet on the ground in any case.
    simulate: fly the fleet of this example, or of the scenario in this .json file, in software inside the service and
    in the scenario's wind, ready for drills. simulate_stations: whether the base stations of that fleet serve, and
    report. simulate_channel: how what users truly get from them differs from what is planned with (`FIELD=VALUE,...` of
    `sim.TruthChannel`). simulate_crew: how many people change batteries on the pads of that fleet, each in
    simulate_turnaround_s; simulate_packs: the batteries of each pad (`FIELD=VALUE,...` of `sim.Packs`);
    simulate_battery_minutes: of hovering on a new one until 20 % is left; simulate_fronts: how the wind changes
    (`FIELD=VALUE,...` of `sim.WindFront`, separated by semicolons).
    heartbeat_stale_s, heartbeat_lost_s: fleet seconds of silence. timing: when everything else about a vehicle counts
    (`mavlink_bridge.conditions.Timing`), as JSON: `{"takeover_after_s": 2, "proof_s": 4}`, or one by one:
    `SKYFOLIO_TIMING__PROOF_S=4`.
    solver: `processes`, or `dask+tcp://HOST:PORT` (`dask+tls://`) of a Dask scheduler, for requests and contingencies.
    solve_deadline_s, replan_deadline_s: wall seconds a solve may take. warm_up: begin to serve when the workers have
    started; else they start with the first solve. plan_starts: starts to climb from at most when a request for a plan
    does not say `starts`; by size, fewer.
    guidance_lead_s: wall seconds reserved for replan and upload; the new plan begins with the first slot after that.
    keep_ended_s: how long ended plans that no operation flew are kept; keep_operations_s: ended operations with their
    plans, journals and tracks; keep_events_s, keep_audit_s: events and audit rows, at most keep_events and keep_audit
    of them. max_cells: UAVs times users times slots; max_plan_cells: users times slots, which is how large a plan is.
    tile_url: of a map server for the dashboard, with {z}, {x} and {y}; without one it draws a grid and loads nothing.
    allowed_hosts: names under which browsers reach the service, separated by commas, beside loopback, the bound address
    and, when more than loopback is bound, IP addresses and this machine's name; `*.example.org` is all below it.
    trusted_proxies: addresses or networks, separated by commas, of proxies whose `X-Forwarded-*` headers are believed.
    root_path: the sub-path under which a proxy offers the service; a trusted proxy may say it in `X-Forwarded-Prefix`.
    rate_per_s, rate_burst: requests of one client. failed_keys_per_minute: wrong API keys that one address may try.
    swap_attempts: attempts at a mission swap before falling back to the last good plan.
    reassociate: whether users of a lost UAV are served by the others at once, before any UAV has moved.
    replan_rates_share: a new plan is made when measured rates differ from those planned by more than this share; 0:
    never.
    disruption_weight: what a recovery's change of the plan must be worth, kbit/s, where an operation does not say it.
    """

    model_config = SettingsConfigDict(env_prefix=PREFIX, env_nested_delimiter=NESTED, frozen=True, extra="forbid")

    host: str = "127.0.0.1"
    port: Annotated[int, Field(ge=0, le=65535)] = 8080
    database_url: str = TEMPORARY
    several_services: bool = False
    lease_s: Annotated[float, Field(ge=1, le=60)] = 2.5
    service_name: Annotated[str, Field(max_length=64)] = ""
    fleet_url: str = "udpin://127.0.0.1:14540"
    forward_url: str | None = None
    forward_commands: bool = False
    signing_key_file: Path | None = None
    telemetry_log_dir: Path | None = None
    preflight: Literal["report", "enforce"] = "report"
    start_within_m: Annotated[float, Field(gt=0)] = START_WITHIN_M
    simulate: str | None = None
    simulate_stations: bool = True
    simulate_channel: Annotated[str, Field(max_length=200)] = ""
    simulate_crew: Annotated[int, Field(ge=0, le=100)] = 0
    simulate_turnaround_s: Annotated[float, Field(ge=10, le=1e6)] = 90.0
    simulate_packs: Annotated[str, Field(max_length=300)] = ""
    simulate_battery_minutes: Annotated[float, Field(ge=1, le=300)] | None = None
    simulate_fronts: Annotated[str, Field(max_length=2000)] = ""
    time_scale: Annotated[float, Field(gt=0, le=100)] = 1.0
    workers: Annotated[int, Field(ge=1, le=64)] = 1
    warm_up: bool = True
    solver: Annotated[str, Field(pattern=r"^(processes|dask\+(tcp|tls)://.+)$")] = "processes"
    queue_limit: Annotated[int, Field(ge=1, le=1024)] = 32
    solve_deadline_s: Annotated[float, Field(gt=0, le=3600)] = 60.0
    heartbeat_stale_s: Seconds = 3.0
    heartbeat_lost_s: Seconds = 5.0
    timing: Timing = Timing()
    replan_deadline_s: Seconds = 2.0
    guidance_lead_s: Annotated[float, Field(ge=0)] = 1.0
    tile_url: Annotated[
        str | None, Field(pattern=r"^https?://.*\{z\}.*\{x\}.*\{y\}|^https?://.*\{z\}.*\{y\}.*\{x\}")
    ] = None
    plan_ahead: bool = True
    swap_attempts: Annotated[int, Field(ge=1, le=5)] = 2
    reassociate: bool = True
    replan_rates_share: Annotated[float, Field(ge=0, le=10, allow_inf_nan=False)] = 0.1
    disruption_weight: Annotated[float, Field(ge=0, le=MOST_WEIGHT, allow_inf_nan=False)] = 0.0
    telemetry_hz: Annotated[float, Field(gt=0, le=50)] = 10.0
    plan_starts: Annotated[int, Field(ge=1, le=64)] = 24
    keep_ended_s: Seconds = 7 * 86_400.0
    keep_operations_s: Seconds = 90 * 86_400.0
    keep_events_s: Seconds = 90 * 86_400.0
    keep_events: Count = 1_000_000
    keep_audit_s: Seconds = 365 * 86_400.0
    keep_audit: Count = 200_000
    max_body_bytes: Count = 2_000_000
    max_uavs: Count = 128
    max_users: Count = 5_000
    max_slots: Count = 2_000
    max_cells: Count = 50_000_000
    max_plan_cells: Count = 2_000_000
    max_subscribers: Count = 256
    rate_per_s: Seconds = 500.0
    rate_burst: Count = 1_000
    failed_keys_per_minute: Count = 10
    allowed_hosts: Annotated[str, Field(pattern=r"^\s*((\*\.)?[\w.:\[\]-]+\s*(,\s*|$))*$")] = ""
    trusted_proxies: str = ""
    root_path: Annotated[str, Field(pattern=f"^{SUB_PATH}$")] = ""

    @field_validator("timing", mode="before")
    @classmethod
    def _said_once(cls, value: Any) -> Any:
        """Refuse a value that has a setting of its own: it would be ignored here."""
        for name, setting in SET_ELSEWHERE.items():
            default = getattr(Timing, name)
            setting_value = value.get(name, default) if isinstance(value, Mapping) else getattr(value, name, default)
            if setting_value != default:
                raise ValueError(f"{name} is not set here but by {setting} ({PREFIX}{setting.upper()})")
        return value

    @field_validator("trusted_proxies")
    @classmethod
    def _addresses(cls, value: str) -> str:
        for address in listed(value):
            ipaddress.ip_network(address, strict=False)
        return value

    @model_validator(mode="after")
    def _shareable(self) -> Self:
        if self.several_services and not self.database_url.startswith("postgresql"):
            raise ValueError("several_services needs PostgreSQL (database_url)")
        if self.several_services and self.simulate is not None:
            raise ValueError("several_services: a simulated fleet inside one service (simulate) ends with it")
        return self

    @property
    def scheduler(self) -> str | None:
        """Return the address of the Dask scheduler, if there is one."""
        return self.solver.removeprefix("dask+") if self.solver.startswith("dask+") else None

    @property
    def on_loopback(self) -> bool:
        """Return whether only this machine can reach the service."""
        if self.host == "localhost":
            return True
        try:
            return ipaddress.ip_address(self.host).is_loopback
        except ValueError:
            return False


def listed(value: str) -> list[str]:
    """Return the values of a setting that are separated by commas."""
    return [part.strip() for part in value.split(",") if part.strip()]


def default_database_url() -> str:
    """Return where `skyfolio serve` and `skyfolio keys` store their data by default."""
    state = os.environ.get("XDG_STATE_HOME") or str(Path.home() / ".local" / "state")
    return f"sqlite+aiosqlite:///{state}/skyfolio/skyfolio.db"
