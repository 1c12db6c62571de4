"""The two autopilots that a vehicle can have: everything in which they differ, in one table each."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.sim.ardupilot_commands import ArdupilotCommands
from skyfolio.sim.ardupilot_failsafes import ArdupilotFailsafes
from skyfolio.sim.ardupilot_missions import ArdupilotMissions
from skyfolio.sim.ardupilot_parameters import ARDUCOPTER_LIMITS, ardupilot_parameters, ardupilot_tuning
from skyfolio.sim.ardupilot_runner import ArdupilotRunner
from skyfolio.sim.boot import ARDUPILOT_BOOT, PX4_BOOT, BootPlan
from skyfolio.sim.command_table import Commands
from skyfolio.sim.failsafes import Failsafes
from skyfolio.sim.hosts import Refusal
from skyfolio.sim.kinematics import Limits
from skyfolio.sim.mission_protocol import MissionProtocol
from skyfolio.sim.mission_runner import MissionRunner
from skyfolio.sim.modes import Mode, ardupilot_base_mode, px4_base_mode
from skyfolio.sim.parameter_store import Parameter
from skyfolio.sim.px4_commands import Px4Commands
from skyfolio.sim.px4_failsafes import Px4Failsafes
from skyfolio.sim.px4_missions import Px4Missions
from skyfolio.sim.px4_parameters import PX4_LIMITS, px4_parameters, px4_tuning
from skyfolio.sim.refusals import (
    ArmingRefusal,
    RefusalHost,
    ardupilot_arming_refusal,
    ardupilot_mode_refusal,
    px4_arming_refusal,
    px4_mode_refusal,
)
from skyfolio.sim.traits import Looks, Traits, Words
from skyfolio.sim.tuning import Tuning


@dataclass(frozen=True, kw_only=True)
class Flavour(Traits):
    """One autopilot: its traits, and the classes and functions of its parts.

    mode_refusal, arming_refusal: why it does not change to a mode, or arm. boot: how it starts. parameters: those with
    which it boots under given limits. tuning: what their values mean. The others are classes of parts.
    """

    mode_refusal: Callable[[RefusalHost, Mode], Refusal]
    arming_refusal: ArmingRefusal
    boot: BootPlan
    failsafes: type[Failsafes]
    parameters: Callable[[Limits], list[Parameter]]
    tuning: Callable[[Mapping[str, float]], Tuning]
    missions: type[MissionProtocol]
    runner: type[MissionRunner]
    commands: type[Commands]


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
    mode_names={
        Mode.TAKEOFF: "Takeoff",
        Mode.HOLD: "Hold",
        Mode.MISSION: "Mission",
        Mode.RTL: "Return",
        Mode.LAND: "Land",
        Mode.POSITION: "Position",
        Mode.GUIDED: "Offboard",
        Mode.STABILIZE: "Stabilized",
    },
    base_mode=px4_base_mode,
    mode_refusal=px4_mode_refusal,
    arming_refusal=px4_arming_refusal,
    boot=PX4_BOOT,
    failsafes=Px4Failsafes,
    looks=Looks(
        present=0x0200C02F,
        enabled=0x0201C02F,
        healthy=0x1320C83F,
        moving=0,
        logging=0,
        vtol_state=dialect.MAV_VTOL_STATE_UNDEFINED,
        gps=(dialect.GPS_FIX_TYPE_3D_FIX, 10, 70, 110),
        no_gps=(dialect.GPS_FIX_TYPE_NO_GPS, 255, 0xFFFF, 0xFFFF),
    ),
    words=Words(
        armed="Armed by external command\t",
        disarmed="Disarmed by external command\t",
        disarmed_by_landing="Disarmed by landing\t",
        disarmed_idle="Disarmed by auto preflight disarming\t",
        took_off="Takeoff detected\t",
        landed="Landing detected\t",
        mission_entered="Executing Mission\t",
    ),
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
        dialect.MAVLINK_MSG_ID_SYSTEM_TIME: 1.0,
    },
    capabilities=_COMMON_CAPABILITIES
    | dialect.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
    | dialect.MAV_PROTOCOL_CAPABILITY_FLIGHT_TERMINATION
    | dialect.MAV_PROTOCOL_CAPABILITY_FTP,
    firmware=1 << 24 | 18 << 16 | 255,  # 1.18.0, release
    bytewise=True,
    mission_ids=True,
    leaves_mission_at_end=True,
    setpoints_move=False,
    guided_needs_stream=True,
    needs_clearance=False,
    has_metadata=True,
    restores_mode=True,
    gives_orders=True,
    announces_mode=False,
    announces_mission=True,
    counts_charge=False,
    capacity_parameter="BAT1_CAPACITY",
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
    mode_names={
        Mode.STABILIZE: "STABILIZE",
        Mode.MISSION: "AUTO",
        Mode.GUIDED: "GUIDED",
        Mode.HOLD: "LOITER",
        Mode.RTL: "RTL",
        Mode.LAND: "LAND",
        Mode.POSITION: "POSHOLD",
        Mode.BRAKE: "BRAKE",
    },
    base_mode=ardupilot_base_mode,
    mode_refusal=ardupilot_mode_refusal,
    arming_refusal=ardupilot_arming_refusal,
    boot=ARDUPILOT_BOOT,
    failsafes=ArdupilotFailsafes,
    looks=Looks(
        present=0x5371FC2F,
        enabled=0x5371FC2F,
        healthy=0x5771FC2F,
        moving=dialect.MAV_SYS_STATUS_SENSOR_XY_POSITION_CONTROL | dialect.MAV_SYS_STATUS_SENSOR_Z_ALTITUDE_CONTROL,
        logging=dialect.MAV_SYS_STATUS_LOGGING,
        vtol_state=dialect.MAV_VTOL_STATE_MC,
        gps=(dialect.GPS_FIX_TYPE_RTK_FIXED, 10, 121, 200),
        no_gps=(dialect.GPS_FIX_TYPE_NO_FIX, 3, 121, 200),
    ),
    words=Words(
        armed="Arming motors",
        disarmed="Disarming motors",
        disarmed_by_landing="Disarming motors",
        disarmed_idle="Disarming motors",
        crashed="Crash: Disarming: AngErr=90>30, Accel=0.0<3.0",
        motor_failed="Potential Thrust Loss (1)",
        fence_taken="Fence Indexed OK",
    ),
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
    firmware=4 << 24 | 6 << 16 | 2 << 8 | 255,  # 4.6.2, release
    bytewise=False,
    mission_ids=False,
    leaves_mission_at_end=False,
    setpoints_move=True,
    guided_needs_stream=False,
    needs_clearance=True,
    has_metadata=False,
    restores_mode=False,
    gives_orders=False,
    announces_mode=True,
    announces_mission=False,
    counts_charge=True,
    capacity_parameter="BATT_CAPACITY",
)

FLAVOURS = {flavour.name: flavour for flavour in (PX4, ARDUPILOT)}
