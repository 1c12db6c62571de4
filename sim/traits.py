"""In what the two autopilots differ that is plain data: names, numbers, words and habits (`sim.flavours` has both)."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from skyfolio.sim.kinematics import Limits
from skyfolio.sim.modes import Mode


@dataclass(frozen=True, kw_only=True)
class Looks:
    """How an autopilot describes itself, as recorded.

    present, enabled, healthy: bit masks of SYS_STATUS. moving: those enabled and healthy only while the autopilot
    controls a position. logging: those enabled only while it is armed. vtol_state: of EXTENDED_SYS_STATE. gps, no_gps:
    fix type, satellites, eph and epv (cm) of GPS_RAW_INT with a position and without.
    """

    present: int
    enabled: int
    healthy: int
    moving: int
    logging: int
    vtol_state: int
    gps: tuple[int, int, int, int]
    no_gps: tuple[int, int, int, int]


@dataclass(frozen=True, kw_only=True)
class Words:
    """The STATUSTEXTs of an autopilot on its way through a flight; None where it sends nothing."""

    armed: str
    disarmed: str
    disarmed_by_landing: str
    disarmed_idle: str
    took_off: str | None = None
    landed: str | None = None
    mission_entered: str | None = None
    crashed: str | None = None
    motor_failed: str | None = None
    fence_taken: str | None = None


@dataclass(frozen=True, kw_only=True)
class Traits:
    """What every part of an autopilot may know of its flavour.

    mav_autopilot: MAV_AUTOPILOT. custom_modes: HEARTBEAT.custom_mode of each mode it has. rates_hz: the streams it
    sends without being asked. bytewise: integer parameters travel as bytes in the float, instead of as a number.
    mission_ids: MISSION_CURRENT and MISSION_ACK carry the CRC-32 of the plan. leaves_mission_at_end: the mission mode
    ends with the mission (PX4), or the vehicle stays in it and hovers. setpoints_move: a streamed position goes on with
    its velocity until the next one. guided_needs_stream: GUIDED/OFFBOARD is refused without setpoints, and left when
    they stop. needs_clearance: armed in the mission mode, the vehicle stays on the ground until MISSION_START or
    AUTO_OPTIONS clears it. has_metadata: it has COMPONENT_METADATA and serves those files by MAVLink FTP.
    restores_mode: disarmed, it shows the last mode in which it can be armed, and its home is where it stands.
    gives_orders: see `sim.chatter`. announces_mode: a change of mode is followed by a HEARTBEAT at once.
    announces_mission: MISSION_CURRENT is sent whenever it changes, and MISSION_ITEM_REACHED ten times more.
    counts_charge: see `sim.gauge`. capacity_parameter: the name of the one that holds the battery's capacity in mAh.
    """

    name: str
    mav_autopilot: int
    custom_modes: Mapping[Mode, int]
    mode_names: Mapping[Mode, str]
    base_mode: Callable[..., int]
    looks: Looks
    words: Words
    boot_mode: Mode
    limits: Limits
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
    restores_mode: bool
    gives_orders: bool
    announces_mode: bool
    announces_mission: bool
    counts_charge: bool
    capacity_parameter: str
