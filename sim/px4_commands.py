"""PX4's way with commands: it arms in any mode, takes off to a height above sea level, and MISSION_START arms."""

import math
from typing import TYPE_CHECKING, Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.sim.command_table import (
    ACCEPTED,
    DENIED,
    FAILED,
    FORCE,
    REJECTED_FOR_NOW,
    UNSUPPORTED,
    Command,
    Commands,
    Outcome,
    index_of,
)
from skyfolio.sim.injection import injected_failure
from skyfolio.sim.modes import Mode
from skyfolio.sim.wire import Message

if TYPE_CHECKING:
    from skyfolio.sim.autopilot import Autopilot

MISSION_CURRENT = dialect.MAVLINK_MSG_ID_MISSION_CURRENT


class Px4Commands(Commands):
    """The command table of a PX4."""

    _message_first = True

    def __init__(self, autopilot: "Autopilot") -> None:
        super().__init__(autopilot)
        self._table[dialect.MAV_CMD_INJECT_FAILURE] = self._inject_failure

    def set_mode_message(self, message: Any) -> list[Message]:
        """Take a SET_MODE; PX4 answers it as a command."""
        main, sub = message.custom_mode >> 16 & 0xFF, message.custom_mode >> 24
        custom = message.base_mode & dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
        mode = self._mode_of(main, sub) if custom else None
        result = UNSUPPORTED if mode is None else self._mode(mode).result
        ack: Message = dialect.MAVLink_command_ack_message(dialect.MAV_CMD_DO_SET_MODE, result)
        return [ack]

    def _arm_disarm(self, command: Command) -> Outcome:
        if command.param1 == 1.0:
            done = self._autopilot.arm()
        elif command.param1 == 0.0:
            done = self._autopilot.disarm(force=command.param2 == FORCE)
            if not done:
                self._autopilot.say("Disarming denied: not landed\t", dialect.MAV_SEVERITY_CRITICAL)
        else:
            return Outcome(UNSUPPORTED)
        return Outcome(ACCEPTED if done else REJECTED_FOR_NOW)

    def _takeoff(self, command: Command) -> Outcome:
        """Param7 is above sea level, as PX4 has it; without it MIS_TAKEOFF_ALT counts."""
        up_m = None if command.alt_m is None else command.alt_m - self._autopilot.spec.home_alt_m
        self._autopilot.takeoff(up_m if up_m is not None and up_m > 0.0 else None)
        return Outcome(ACCEPTED)

    def _set_mode(self, command: Command) -> Outcome:
        mode = self._mode_of(command.param2, command.param3)
        custom = command.param1 >= 0.0 and index_of(command.param1) & dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
        if not custom or mode is None:
            return Outcome(UNSUPPORTED)
        return self._mode(mode)

    def _mode_of(self, main: float, sub: float) -> Mode | None:
        """Return the mode of PX4's main and sub mode, or None if there is no such mode here."""
        known = self._autopilot.flavour.custom_modes
        found = (mode for mode, custom in known.items() if (custom >> 16 & 0xFF, custom >> 24) == (main, sub))
        return next(found, None)

    def _mode(self, mode: Mode) -> Outcome:
        return Outcome(ACCEPTED if self._autopilot.set_mode(mode) else REJECTED_FOR_NOW)

    def _change_speed(self, command: Command) -> Outcome:
        """Any mode obeys, RTL too; entering the next one forgets it."""
        if not math.isfinite(command.param2):
            return Outcome(DENIED)
        speed_mps = command.param2 if command.param2 > 0.0 else None
        self._autopilot.runner.speed_mps = self._autopilot.navigator.speed_mps = speed_mps
        return Outcome(ACCEPTED)

    def _reboot(self, command: Command) -> Outcome:
        """param1 = 1 or 3 reboots, 0 does nothing; never while it is armed."""
        if command.param1 == 0.0:
            return Outcome(ACCEPTED)
        if command.param1 not in (1.0, 3.0) or self._autopilot.armed:
            return Outcome(DENIED)
        self._autopilot.mishaps.ask_reboot()
        return Outcome(ACCEPTED)

    def _reposition(self, command: Command) -> Outcome:
        place = self._place(command)
        if place is None:
            return Outcome(DENIED)
        self._autopilot.reposition(*place, command.param1)
        return Outcome(ACCEPTED)

    def _mission_start(self, command: Command) -> Outcome:
        """Start at item param1 and arm, as PX4 does."""
        if not self._autopilot.runner.mission.items:
            self._autopilot.say("Mission start denied! No valid mission\t", dialect.MAV_SEVERITY_CRITICAL)
            return Outcome(DENIED)
        if not self._autopilot.jump(index_of(command.param1)) or not self._autopilot.set_mode(Mode.MISSION):
            return Outcome(REJECTED_FOR_NOW)
        return Outcome(ACCEPTED if self._autopilot.arm() else REJECTED_FOR_NOW)

    def _set_mission_current(self, command: Command) -> Outcome:
        """PX4 has only the message MISSION_SET_CURRENT."""
        del command
        return Outcome(UNSUPPORTED)

    def _send(self, message_id: int) -> Outcome:
        """MISSION_CURRENT is no stream of PX4's, so it cannot be asked for."""
        return Outcome(DENIED) if message_id == MISSION_CURRENT else super()._send(message_id)

    def _set_message_interval(self, command: Command) -> Outcome:
        if index_of(command.param1) == MISSION_CURRENT:
            return Outcome(FAILED)
        return super()._set_message_interval(command)

    def _go_home(self, command: Command) -> Outcome:
        return self._said(super()._go_home(command), "Returning to launch\t")

    def _land(self, command: Command) -> Outcome:
        return self._said(super()._land(command), "Landing at current position\t")

    def _said(self, outcome: Outcome, words: str) -> Outcome:
        if outcome.result == ACCEPTED:
            self._autopilot.say(words)
        return outcome

    def _inject_failure(self, command: Command) -> Outcome:
        if not self._autopilot.parameters.tuning.failures_enabled:
            return Outcome(DENIED)
        done = injected_failure(self._autopilot, index_of(command.param1), index_of(command.param2))
        return Outcome(ACCEPTED if done else UNSUPPORTED)
