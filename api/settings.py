"""Settings of the service: environment variables `SKYFOLIO_*`, or arguments of `skyfolio serve`."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field
from pydantic_settings import BaseSettings, SettingsConfigDict


class Settings(BaseSettings):
    """How the service runs. It binds to loopback unless told otherwise.

    time_scale: how much faster than real time the (simulated) fleet lives; leave it at 1 for real aircraft.
    heartbeat_stale_s, heartbeat_lost_s: fleet seconds of silence. replan_deadline_s: wall seconds a replan may take.
    guidance_lead_s: wall seconds reserved for replan and upload; the new plan begins with the first slot after that.
    tile_url: of a map server for the dashboard, with {z}, {x} and {y}; without one it draws a grid and asks nobody.
    """

    model_config = SettingsConfigDict(env_prefix="SKYFOLIO_", frozen=True, extra="forbid")

    host: str = "127.0.0.1"
    port: Annotated[int, Field(ge=0, le=65535)] = 8080
    fleet_url: str = "udpin://127.0.0.1:14540"
    time_scale: Annotated[float, Field(gt=0, le=100)] = 1.0
    workers: Annotated[int, Field(ge=1, le=64)] = 1
    queue_limit: Annotated[int, Field(ge=1, le=1024)] = 32
    heartbeat_stale_s: Annotated[float, Field(gt=0)] = 3.0
    heartbeat_lost_s: Annotated[float, Field(gt=0)] = 5.0
    replan_deadline_s: Annotated[float, Field(gt=0)] = 2.0
    guidance_lead_s: Annotated[float, Field(ge=0)] = 1.0
    tile_url: Annotated[
        str | None, Field(pattern=r"^https?://.*\{z\}.*\{x\}.*\{y\}|^https?://.*\{z\}.*\{y\}.*\{x\}")
    ] = None
