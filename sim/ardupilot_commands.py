"""ArduCopter's way with commands.

It arms in GUIDED and the pilot's modes, in AUTO only with AUTO_OPTIONS bit 0; takes off by command in GUIDED, armed,
to an altitude above home; MISSION_START changes to AUTO and lets it leave the ground, but does not arm.
"""

from typing import TYPE_CHECKING, Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.sim.command_table import (
    ACCEPTED,
    DENIED,
    FAILED,
    FORCE,
    UNSUPPORTED,
    Command,
    Commands,
    Outcome,
    index_of,
)
from skyfolio.sim.modes import Mode
from skyfolio.sim.wire import Message

if TYPE_CHECKING:
    from skyfolio.sim.autopilot import Autopilot

_WITH_SPEED = (Mode.MISSION, Mode.RTL, Mode.GUIDED)
_CLIMB_SPEED = 2.0
FORCE_REBOOT = 20190226.0
"""param6 of MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN that reboots an armed vehicle."""
_PAUSE, _CONTINUE = 0.0, 1.0


class ArdupilotCommands(Commands):
    """The command table of an ArduCopter."""

    _unknown_message = FAILED

    def __init__(self, autopilot: "Autopilot") -> None:
        super().__init__(autopilot)
        self._table[dialect.MAV_CMD_DO_PAUSE_CONTINUE] = self._pause_continue

    def set_mode_message(self, message: Any) -> list[Message]:
        """Take a SET_MODE; ArduPilot does not answer it."""
        mode = self._mode_of(message.custom_mode)
        if mode is not None and message.base_mode & dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
            self._autopilot.set_mode(mode)
        return []

    def _arm_disarm(self, command: Command) -> Outcome:
        force = command.param2 == FORCE
        if command.param1 == 1.0:
            return Outcome(ACCEPTED if self._autopilot.arm(force=force) else FAILED)
        if command.param1 == 0.0:
            return Outcome(ACCEPTED if self._autopilot.disarm(force=force) else FAILED)
        return Outcome(UNSUPPORTED)

    def _takeoff(self, command: Command) -> Outcome:
        """Param7 is above home in a COMMAND_LONG; a COMMAND_INT must say so by its frame."""
        autopilot = self._autopilot
        relative = not command.is_int or command.frame == dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT
        ready = autopilot.armed and autopilot.mode is Mode.GUIDED and autopilot.body.on_ground
        if not relative:
            return Outcome(DENIED)
        if not ready or command.alt_m is None or command.alt_m <= autopilot.body.up_m:
            return Outcome(FAILED)
        autopilot.takeoff(command.alt_m)
        return Outcome(ACCEPTED)

    def _set_mode(self, command: Command) -> Outcome:
        custom = command.param1 >= 0.0 and index_of(command.param1) & dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
        if not custom:
            return Outcome(DENIED)
        mode = self._mode_of(command.param2)
        return Outcome(FAILED) if mode is None else self._mode(mode)

    def _mode_of(self, custom_mode: float) -> Mode | None:
        known = self._autopilot.flavour.custom_modes
        return next((mode for mode, custom in known.items() if custom == custom_mode), None)

    def _mode(self, mode: Mode) -> Outcome:
        return Outcome(ACCEPTED if self._autopilot.set_mode(mode) else FAILED)

    def _change_speed(self, command: Command) -> Outcome:
        """Only AUTO, RTL and GUIDED have a speed to set, until they are entered again; climbing has its own."""
        autopilot = self._autopilot
        if not 0.0 < command.param2 < 1000.0 or autopilot.mode not in _WITH_SPEED:
            return Outcome(FAILED)
        if command.param1 >= _CLIMB_SPEED:
            return Outcome(ACCEPTED)
        if autopilot.mode is Mode.MISSION:
            autopilot.runner.speed_mps = command.param2
        else:
            autopilot.navigator.speed_mps = command.param2
        return Outcome(ACCEPTED)

    def _reboot(self, command: Command) -> Outcome:
        """param1 = 1 (or 3) reboots; armed only if param6 insists, in the air then too."""
        insists = command.lon_deg is not None and command.lon_deg in (FORCE_REBOOT, FORCE_REBOOT / 1e7)
        if self._autopilot.armed and not insists:
            return Outcome(FAILED)
        if command.param1 not in (1.0, 3.0):
            return Outcome(UNSUPPORTED)
        self._autopilot.mishaps.ask_reboot()
        return Outcome(ACCEPTED)

    def _reposition(self, command: Command) -> Outcome:
        """Outside GUIDED only with MAV_DO_REPOSITION_FLAGS_CHANGE_MODE; a place is required."""
        autopilot = self._autopilot
        change = index_of(command.param2) & dialect.MAV_DO_REPOSITION_FLAGS_CHANGE_MODE if command.param2 > 0 else 0
        if autopilot.mode is not Mode.GUIDED and not change:
            return Outcome(DENIED)
        place = self._place(command)
        if place is None or place[0] is None:
            return Outcome(DENIED)
        if not autopilot.set_mode(Mode.GUIDED):
            return Outcome(FAILED)
        autopilot.navigator.go_to(*place, command.param1)
        return Outcome(ACCEPTED)

    def _mission_start(self, command: Command) -> Outcome:
        autopilot = self._autopilot
        if command.param1 != 0.0 or command.param2 != 0.0:
            return Outcome(DENIED)
        if autopilot.mode is not Mode.MISSION and not autopilot.set_mode(Mode.MISSION):
            return Outcome(FAILED)
        autopilot.start_mission()
        return Outcome(ACCEPTED)

    def _set_mission_current(self, command: Command) -> Outcome:
        """DENIED for what is not in the mission, FAILED where nothing is left to fly from there."""
        seq = index_of(command.param1)
        if not 0 <= seq < len(self._autopilot.runner.mission):
            return Outcome(DENIED)
        if not self._autopilot.jump(seq):
            return Outcome(FAILED)
        self._autopilot.announce(dialect.MAVLINK_MSG_ID_MISSION_CURRENT)
        return Outcome(ACCEPTED)

    def _pause_continue(self, command: Command) -> Outcome:
        """Pause or continue in AUTO and GUIDED."""
        if command.param1 not in (_PAUSE, _CONTINUE):
            return Outcome(DENIED)
        return Outcome(ACCEPTED if self._autopilot.pause(paused=command.param1 == _PAUSE) else FAILED)
