"""The two autopilots this fleet can be: everything in which they differ, in one table each."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from pymavlink.dialects.v20 import ardupilotmega as dialect

from sim.ardupilot_commands import ArdupilotCommands
from sim.ardupilot_missions import ArdupilotMissions
from sim.ardupilot_parameters import ARDUCOPTER_LIMITS, ardupilot_parameters, ardupilot_tuning
from sim.ardupilot_runner import ArdupilotRunner
from sim.commands import Commands
from sim.mission_protocol import MissionProtocol
from sim.mission_runner import MissionRunner
from sim.modes import Mode
from sim.parameters import Parameter
from sim.px4_commands import Px4Commands
from sim.px4_missions import Px4Missions
from sim.px4_parameters import PX4_LIMITS, px4_parameters, px4_tuning
from sim.tuning import Tuning
from sim.vehicle import Limits


@dataclass(frozen=True, kw_only=True)
class Flavour:
    """One autopilot.

    custom_modes: HEARTBEAT.custom_mode of each mode it has. rates_hz: what it streams unasked. bytewise: how integer
    parameters travel. mission_ids: MISSION_CURRENT and MISSION_ACK carry the CRC of the plan. leaves_mission_at_end:
    the mission mode ends with the mission (PX4), or the vehicle stays in it and hovers. setpoints_move: a streamed
    position goes on with its velocity until the next one. guided_needs_stream: GUIDED/OFFBOARD is refused without
    setpoints and left without them. needs_clearance: armed in the mission mode it stays on the ground until
    MISSION_START or AUTO_OPTIONS lets it go. has_metadata: COMPONENT_METADATA, and its files by MAVLink FTP.
    """

    name: str
    mav_autopilot: int
    custom_modes: Mapping[Mode, int]
    boot_mode: Mode
    limits: Limits
    parameters: Callable[[Limits], list[Parameter]]
    tuning: Callable[[Mapping[str, float]], Tuning]
    missions: type[MissionProtocol]
    runner: type[MissionRunner]
    commands: type[Commands]
    rates_hz: Mapping[int, float]
    capabilities: int
    firmware: int
    bytewise: bool
    mission_ids: bool
    leaves_mission_at_end: bool
    setpoints_move: bool
    guided_needs_stream: bool
    needs_clearance: bool
    has_metadata: bool
    resumes_after_link_loss: bool
    failsafe_hold: Mode


_COMMON_CAPABILITIES = (
    dialect.MAV_PROTOCOL_CAPABILITY_MISSION_INT
    | dialect.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
    | dialect.MAV_PROTOCOL_CAPABILITY_MAVLINK2
    | dialect.MAV_PROTOCOL_CAPABILITY_MISSION_FENCE
    | dialect.MAV_PROTOCOL_CAPABILITY_MISSION_RALLY
    | dialect.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
    | dialect.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_GLOBAL_INT
)

PX4 = Flavour(
    name="px4",
    mav_autopilot=dialect.MAV_AUTOPILOT_PX4,
    custom_modes={
        Mode.TAKEOFF: 4 << 16 | 2 << 24,
        Mode.HOLD: 4 << 16 | 3 << 24,
        Mode.MISSION: 4 << 16 | 4 << 24,
        Mode.RTL: 4 << 16 | 5 << 24,
        Mode.LAND: 4 << 16 | 6 << 24,
        Mode.POSITION: 3 << 16,
        Mode.GUIDED: 6 << 16,
        Mode.STABILIZE: 7 << 16,
    },
    boot_mode=Mode.HOLD,
    limits=PX4_LIMITS,
    parameters=px4_parameters,
    tuning=px4_tuning,
    missions=Px4Missions,
    runner=MissionRunner,
    commands=Px4Commands,
    rates_hz={
        dialect.MAVLINK_MSG_ID_HEARTBEAT: 1.0,
        dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 5.0,
        dialect.MAVLINK_MSG_ID_MISSION_CURRENT: 1.0,
        dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 1.0,
        dialect.MAVLINK_MSG_ID_SYS_STATUS: 1.0,
        dialect.MAVLINK_MSG_ID_GPS_RAW_INT: 1.0,
        dialect.MAVLINK_MSG_ID_ATTITUDE: 1.0,
        dialect.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: 1.0,
        dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 1.0,
        dialect.MAVLINK_MSG_ID_VFR_HUD: 1.0,
        dialect.MAVLINK_MSG_ID_BATTERY_STATUS: 0.5,
        dialect.MAVLINK_MSG_ID_HOME_POSITION: 0.5,
    },
    capabilities=_COMMON_CAPABILITIES
    | dialect.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
    | dialect.MAV_PROTOCOL_CAPABILITY_FLIGHT_TERMINATION
    | dialect.MAV_PROTOCOL_CAPABILITY_FTP,
    firmware=1 << 24 | 16 << 16 | 255,  # 1.16.0, release
    bytewise=True,
    mission_ids=True,
    leaves_mission_at_end=True,
    setpoints_move=False,
    guided_needs_stream=True,
    needs_clearance=False,
    has_metadata=True,
    resumes_after_link_loss=True,
    failsafe_hold=Mode.HOLD,
)

ARDUPILOT = Flavour(
    name="ardupilot",
    mav_autopilot=dialect.MAV_AUTOPILOT_ARDUPILOTMEGA,
    custom_modes={
        Mode.STABILIZE: 0,
        Mode.MISSION: 3,
        Mode.GUIDED: 4,
        Mode.HOLD: 5,
        Mode.RTL: 6,
        Mode.LAND: 9,
        Mode.POSITION: 16,
        Mode.BRAKE: 17,
    },
    boot_mode=Mode.STABILIZE,
    limits=ARDUCOPTER_LIMITS,
    parameters=ardupilot_parameters,
    tuning=ardupilot_tuning,
    missions=ArdupilotMissions,
    runner=ArdupilotRunner,
    commands=ArdupilotCommands,
    rates_hz={dialect.MAVLINK_MSG_ID_HEARTBEAT: 1.0},
    capabilities=_COMMON_CAPABILITIES
    | dialect.MAV_PROTOCOL_CAPABILITY_MISSION_FLOAT
    | dialect.MAV_PROTOCOL_CAPABILITY_PARAM_FLOAT
    | dialect.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST,
    firmware=4 << 24 | 6 << 16 | 255,  # 4.6.0, release
    bytewise=False,
    mission_ids=False,
    leaves_mission_at_end=False,
    setpoints_move=True,
    guided_needs_stream=False,
    needs_clearance=True,
    has_metadata=False,
    resumes_after_link_loss=False,
    failsafe_hold=Mode.BRAKE,
)

FLAVOURS = {flavour.name: flavour for flavour in (PX4, ARDUPILOT)}
