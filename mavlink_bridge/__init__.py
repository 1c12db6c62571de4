"""The bridge between plans and vehicles: missions out, telemetry and heartbeats in. Built on MAVSDK.

    plan --schedule, pace--> writer (px4, ardupilot) --compiler--> Mission --verified, transfer--> vehicle
    verified: mission_protocol up and down, then compare by what this autopilot keeps (readback)
    vehicle: command_protocol; every question to it shares one round_trip
    vehicle --endpoints, hub (routing, signing, watchers, tlog)--> MAVSDK --vehicle, telemetry--> classifier --> Change
    readiness: wait for facts, arm    departure: launch, go to, start together    flight: swap in flight, hold, land
    guidance: keeper over missions, or stream of setpoints       guard: a process that ends the stream if we die
    before take-off: models, parameters, preflight (findings, parameter_rules), fence
    after a loss: ghosts, transitions, corridors    what a vehicle is: senders (who speaks for it), evidence, disarming

Pure and testable without a socket: everything that plans, compares, judges or speaks a protocol (`mission_protocol`,
`command_protocol`, `verified`, `parameters`, `keeper`, `stream`, `classifier`, `routing`, ...): messages and time go
in, messages come out.
Sockets, threads and waiting are in endpoints, hub, listening, link, vehicle, transfer, readiness, departure, flight,
guidance and guard.
A new autopilot is a new writer, a row in `autopilots` and `models`, its rows in `readback`, and its rules in
`parameter_rules`.
The package knows the planner's plan type and nothing of the service or the simulator. pymavlink is only used for what
MAVSDK has not: framing and signing.
"""

from skyfolio.mavlink_bridge.autopilots import DEFAULT_AUTOPILOT, Autopilot, FlightMode
from skyfolio.mavlink_bridge.compare import mission_differences
from skyfolio.mavlink_bridge.compiler import compile_mission
from skyfolio.mavlink_bridge.errors import (
    BridgeError,
    CompileError,
    ConnectionFailed,
    FormatError,
    GuardFailed,
    LinkClosed,
    LinkError,
    ReturnPathsTooClose,
    TooManyItems,
    UnknownAutopilot,
    UnknownUav,
    VehiclesMissing,
)
from skyfolio.mavlink_bridge.formats import from_qgc_plan, from_waypoints, to_qgc_plan, to_waypoints
from skyfolio.mavlink_bridge.geodesy import east_north_to_geodetic, geodetic_to_east_north
from skyfolio.mavlink_bridge.heartbeat import AUTOPILOT, HeartbeatMonitor, LinkEvent, LinkState
from skyfolio.mavlink_bridge.hub import LinkOptions
from skyfolio.mavlink_bridge.items import MAX_ITEMS, Command, Frame, Mission, MissionItem
from skyfolio.mavlink_bridge.link import FleetLink
from skyfolio.mavlink_bridge.models import model_from_parameters
from skyfolio.mavlink_bridge.pace import VehicleModel
from skyfolio.mavlink_bridge.plan_extras import fence_from_qgc_plan, rally_from_qgc_plan
from skyfolio.mavlink_bridge.results import CommandResult, SwapResult, UploadResult
from skyfolio.mavlink_bridge.returns import check_return_paths
from skyfolio.mavlink_bridge.signing import Signing
from skyfolio.mavlink_bridge.telemetry import LandedState, Telemetry
from skyfolio.mavlink_bridge.writer import OnEnd

__all__ = [
    "AUTOPILOT",
    "DEFAULT_AUTOPILOT",
    "MAX_ITEMS",
    "Autopilot",
    "BridgeError",
    "Command",
    "CommandResult",
    "CompileError",
    "ConnectionFailed",
    "FleetLink",
    "FlightMode",
    "FormatError",
    "Frame",
    "GuardFailed",
    "HeartbeatMonitor",
    "LandedState",
    "LinkClosed",
    "LinkError",
    "LinkEvent",
    "LinkOptions",
    "LinkState",
    "Mission",
    "MissionItem",
    "OnEnd",
    "ReturnPathsTooClose",
    "Signing",
    "SwapResult",
    "Telemetry",
    "TooManyItems",
    "UnknownAutopilot",
    "UnknownUav",
    "UploadResult",
    "VehicleModel",
    "VehiclesMissing",
    "check_return_paths",
    "compile_mission",
    "east_north_to_geodetic",
    "fence_from_qgc_plan",
    "from_qgc_plan",
    "from_waypoints",
    "geodetic_to_east_north",
    "mission_differences",
    "model_from_parameters",
    "rally_from_qgc_plan",
    "to_qgc_plan",
    "to_waypoints",
]
