"""The commands of an ArduCopter.

It arms in GUIDED and in the pilot's modes, and in AUTO only with AUTO_OPTIONS bit 0. It takes off by command in GUIDED,
armed, to an altitude above home. MISSION_START changes to AUTO and lets it leave the ground, but does not arm.
"""

from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.sim.command_table import (
    ACCEPTED,
    DENIED,
    FAILED,
    FORCE,
    UNSUPPORTED,
    Command,
    CommandHost,
    Commands,
    Outcome,
    index_of,
)
from skyfolio.sim.modes import Mode
from skyfolio.sim.wire import Message

_WITH_SPEED = (Mode.MISSION, Mode.RTL, Mode.GUIDED)
_CLIMB_SPEED = 2.0
FORCE_REBOOT = 20190226.0
"""param6 of MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN that reboots an armed vehicle."""
_PAUSE, _CONTINUE = 0.0, 1.0


class ArdupilotCommands(Commands):
    """The command table of an ArduCopter."""

    _unknown_message = FAILED

    def __init__(self, host: CommandHost) -> None:
        super().__init__(host)
        self._table[dialect.MAV_CMD_DO_PAUSE_CONTINUE] = self._pause_continue

    def set_mode_message(self, message: Any) -> list[Message]:
        """Obey a SET_MODE; ArduPilot does not acknowledge it."""
        mode = self._mode_of(message.custom_mode)
        if mode is not None and message.base_mode & dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
            self._host.set_mode(mode)
        return []

    def _arm_disarm(self, command: Command) -> Outcome:
        force = command.param2 == FORCE
        if command.param1 == 1.0:
            return Outcome(ACCEPTED if self._host.arm(force=force) else FAILED)
        if command.param1 == 0.0:
            return Outcome(ACCEPTED if self._host.disarm(force=force) else FAILED)
        return Outcome(UNSUPPORTED)

    def _takeoff(self, command: Command) -> Outcome:
        """Take off to param7, metres above home; the frame of a COMMAND_INT must be GLOBAL_RELATIVE_ALT."""
        host = self._host
        relative = not command.is_int or command.frame == dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT
        ready = host.armed and host.mode is Mode.GUIDED and host.body.on_ground
        if not relative:
            return Outcome(DENIED)
        if not ready or command.alt_m is None or command.alt_m <= host.body.up_m:
            return Outcome(FAILED)
        host.takeoff(command.alt_m)
        return Outcome(ACCEPTED)

    def _set_mode(self, command: Command) -> Outcome:
        custom = command.param1 >= 0.0 and index_of(command.param1) & dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
        if not custom:
            return Outcome(DENIED)
        mode = self._mode_of(command.param2)
        return Outcome(FAILED) if mode is None else self._mode(mode)

    def _mode_of(self, custom_mode: float) -> Mode | None:
        modes = self._host.traits.custom_modes.items()
        return next((mode for mode, custom in modes if custom == custom_mode), None)

    def _mode(self, mode: Mode) -> Outcome:
        return Outcome(ACCEPTED if self._host.set_mode(mode) else FAILED)

    def _change_speed(self, command: Command) -> Outcome:
        """Set the speed of AUTO, RTL or GUIDED until it is entered again; climbing has a speed of its own."""
        host = self._host
        if not 0.0 < command.param2 < 1000.0 or host.mode not in _WITH_SPEED:
            return Outcome(FAILED)
        if command.param1 >= _CLIMB_SPEED:
            return Outcome(ACCEPTED)
        if host.mode is Mode.MISSION:
            host.runner.speed_mps = command.param2
        else:
            host.navigator.speed_mps = command.param2
        return Outcome(ACCEPTED)

    def _reboot(self, command: Command) -> Outcome:
        """Reboot if param1 is 1 or 3; while armed only with param6 FORCE_REBOOT, which counts in the air too."""
        insists = command.lon_deg is not None and command.lon_deg in (FORCE_REBOOT, FORCE_REBOOT / 1e7)
        if self._host.armed and not insists:
            return Outcome(FAILED)
        if command.param1 not in (1.0, 3.0):
            return Outcome(UNSUPPORTED)
        self._host.component_failures.request_reboot()
        return Outcome(ACCEPTED)

    def _reposition(self, command: Command) -> Outcome:
        """Fly to a place, which is required; outside GUIDED only with MAV_DO_REPOSITION_FLAGS_CHANGE_MODE."""
        host = self._host
        change = index_of(command.param2) & dialect.MAV_DO_REPOSITION_FLAGS_CHANGE_MODE if command.param2 > 0 else 0
        if host.mode is not Mode.GUIDED and not change:
            return Outcome(DENIED)
        place = self._place(command)
        if place is None or place[0] is None:
            return Outcome(DENIED)
        if not host.set_mode(Mode.GUIDED):
            return Outcome(FAILED)
        host.navigator.go_to(*place, command.param1)
        return Outcome(ACCEPTED)

    def _mission_start(self, command: Command) -> Outcome:
        host = self._host
        if command.param1 != 0.0 or command.param2 != 0.0:
            return Outcome(DENIED)
        if host.mode is not Mode.MISSION and not host.set_mode(Mode.MISSION):
            return Outcome(FAILED)
        host.navigator.start_mission()
        return Outcome(ACCEPTED)

    def _set_mission_current(self, command: Command) -> Outcome:
        """Make item param1 current; DENIED if there is none, FAILED if there is nothing to fly from there."""
        seq = index_of(command.param1)
        if not 0 <= seq < len(self._host.runner.mission):
            return Outcome(DENIED)
        if not self._host.plans.jump(seq):
            return Outcome(FAILED)
        self._host.announce(dialect.MAVLINK_MSG_ID_MISSION_CURRENT)
        return Outcome(ACCEPTED)

    def _pause_continue(self, command: Command) -> Outcome:
        """Pause or go on, in AUTO and GUIDED."""
        if command.param1 not in (_PAUSE, _CONTINUE):
            return Outcome(DENIED)
        if self._host.mode not in (Mode.MISSION, Mode.GUIDED):
            return Outcome(FAILED)
        self._host.navigator.pause(paused=command.param1 == _PAUSE)
        return Outcome(ACCEPTED)
