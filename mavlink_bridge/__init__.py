"""The bridge between plans and vehicles: missions out, telemetry and heartbeats in. Built on MAVSDK.

    plan -> mission    compiler, schedule, pace, reach, items, writer, fence; formats, plan_extras; plane, e7
    one autopilot      autopilots (names), profile (what there is to know), px4, ardupilot, profiles (rows), speaker
    protocols          mission_protocol, command_protocol, parameters; proof: verified, compare, readback
    ports              message_port (what MAVSDK is to the link), mavsdk_port, ports (sockets and MAVSDK by default)
    links              endpoints, serial_line, hub, routing, senders, signing, framing, tlog, watchers, pauses
    one vehicle        vehicle, telemetry; readiness -> departure -> flight, transfer, speeds; confirming
    the fleet          link (`FleetLink`) on listening; before take-off: preflight, findings, parameter_rules
    guidance           keeping (missions) on keeper, slip; guidance (setpoints) on stream; route, deviations;
                       guard: a process that outlives ours
    what happened      heartbeat; classifier on evidence (height, disarming, reboot, status_texts), conditions
    after a loss       ghosts, transitions, corridors, returns

Pure and tested without a socket: everything that plans, compares, judges or speaks a protocol; messages and time go
in, messages come out. Sockets, threads and waiting belong to endpoints, hub, listening, link, vehicle and what waits
for one vehicle; keep it so. The package knows the planner's plan type and nothing of the service or the simulator.
pymavlink may only be used for what MAVSDK lacks: framing and signing. Ask a profile, never which autopilot it is: a
new one is a name in `Autopilot`, one file like `px4`, and a row in `profiles`. Missions and the proof of what is on
board are contracts: golden files and recordings of real flights in the tests hold them.
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
from skyfolio.planner.geodesy import east_north_to_geodetic, geodetic_to_east_north

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
