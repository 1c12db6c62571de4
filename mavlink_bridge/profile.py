"""What the bridge has to know about one autopilot: everything in which autopilots differ, in one record each.

To add an autopilot, add its name to `Autopilot`, write one file with its `AutopilotProfile` (see `px4`), and list it
in `profiles`. Nothing else in the bridge or the service asks which autopilot a vehicle has.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from skyfolio.mavlink_bridge.autopilots import Autopilot, FlightMode, MavAutopilot
from skyfolio.mavlink_bridge.findings import Needs
from skyfolio.mavlink_bridge.items import MissionItem
from skyfolio.mavlink_bridge.mission_messages import MissionType
from skyfolio.mavlink_bridge.pace import VehicleModel
from skyfolio.mavlink_bridge.parameter_rules import Rule
from skyfolio.mavlink_bridge.readback import LITERALLY, Kept
from skyfolio.mavlink_bridge.writer import MissionWriter

Parameters = Mapping[str, float]
"""Values of the vehicle's own parameters by name; a vehicle may know only some of them."""
UNKNOWN_TOTAL = 65535
"""MISSION_CURRENT.total of an autopilot that does not report it (UINT16_MAX)."""


@dataclass(frozen=True, kw_only=True)
class Takeoff:
    """How MAV_CMD_NAV_TAKEOFF (22) is sent to a vehicle on the ground.

    armed_in: the mode to change to before arming (None: any mode will do). mode: the mode it changes to by itself when
    it accepts the command (None: it stays in the one it has). params(up_m, home_amsl_m): param1 to param7 for a climb
    to `up_m` metres above a home that lies `home_amsl_m` metres above mean sea level; None is sent as NaN.
    """

    armed_in: FlightMode | None
    mode: FlightMode | None
    params: Callable[[float, float], tuple[float | None, ...]]


@dataclass(frozen=True, kw_only=True)
class AutopilotProfile:
    """One autopilot.

    Modes: read_mode turns HEARTBEAT.custom_mode into a mode. mode_numbers: (param2, param3) of MAV_CMD_DO_SET_MODE
    (176) for each mode that is commanded. hold_mode: hovers until the next command. stream_mode: follows streamed
    setpoints. our_modes: the modes in which the service may command the vehicle; in any other a human or a failsafe
    flies it.

    Missions: home_first: item 0 of a mission is the vehicle's home. replaces_whole: a new mission takes the place of
    the old one at once, when it is complete, and is flown from then on; else items are overwritten one by one in the
    mission that is flown. restarts_hold: a hold begins again when its item is made current again.
    read_window: the number of items that may be requested at once. kept: what is stored of each item (`readback`).

    Vehicle: default_model: how it flies with its default parameters. model_of: how it flies with these parameters,
    read under the names `model_parameters`. speed_parameters: the names of its speed limit. agility: advice that
    would let it reach the speed of a plan within half a slot. bytewise_parameters: an integer is sent as the bytes of
    the float in PARAM_VALUE (MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE). rules: what the preflight audit checks.
    """

    autopilot: Autopilot
    title: str
    mav_autopilot: MavAutopilot
    read_mode: Callable[[int], FlightMode]
    mode_numbers: Mapping[FlightMode, tuple[int, int]]
    hold_mode: FlightMode
    stream_mode: FlightMode
    our_modes: frozenset[FlightMode]
    takeoff: Takeoff
    writer: type[MissionWriter]
    home_first: bool
    replaces_whole: bool
    restarts_hold: bool
    read_window: int
    kept: Mapping[MissionType, Mapping[int, Kept]]
    default_model: VehicleModel
    model_of: Callable[[Parameters], VehicleModel]
    model_parameters: tuple[str, ...]
    speed_parameters: tuple[str, ...]
    agility: Callable[[Needs], str]
    bytewise_parameters: bool
    rules: tuple[Rule, ...]

    def numbers_of(self, mode: FlightMode) -> tuple[int, int]:
        """Return (param2, param3) of MAV_CMD_DO_SET_MODE (176). Raises ValueError for a mode never commanded."""
        try:
            return self.mode_numbers[mode]
        except KeyError:
            raise ValueError(f"mode: '{mode}' is not one {self.autopilot} is commanded into") from None

    def items_on_board(self, total: int) -> int | None:
        """Return the length of the uploaded mission from MISSION_CURRENT.total, None if it is not reported.

        An autopilot whose item 0 is its home does not count it.
        """
        if total == UNKNOWN_TOTAL:
            return None
        return total + 1 if self.home_first and total > 0 else total

    def current_after(self, items: Sequence[MissionItem], wanted: int) -> range:
        """Return the seqs one of which MISSION_CURRENT reports once item `wanted` has been made current.

        Autopilots move on to the next item that is flown: ArduPilot at once, PX4 as soon as it flies its mission. Item
        0, where it is home, stands for item 1. Without `items` (not known) only the item itself is expected.
        """
        first = max(wanted, 1) if self.home_first else wanted
        flown = next((item.seq for item in items[first:] if item.is_flown), first)
        return range(min(wanted, first), flown + 1)

    def kept_of(self, mission_type: MissionType, command: int) -> Kept:
        """Return what is stored of an item with this MAV_CMD; everything, for a command that has no row."""
        return self.kept[mission_type].get(command, LITERALLY)

    def parameter_names(self) -> tuple[str, ...]:
        """Return the names of the parameters that the preflight audit and the vehicle model read."""
        ruled = [name for rule in self.rules for name in rule.names]
        return tuple(dict.fromkeys([*ruled, *self.model_parameters]))
