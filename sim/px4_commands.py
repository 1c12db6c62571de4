"""The commands of a PX4: it arms in any mode, takes off to a height above sea level, and arms at MISSION_START."""

import math
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.sim.command_table import (
    ACCEPTED,
    DENIED,
    FAILED,
    FORCE,
    REJECTED_FOR_NOW,
    UNSUPPORTED,
    Command,
    CommandHost,
    Commands,
    Outcome,
    index_of,
)
from skyfolio.sim.injection import injected_failure
from skyfolio.sim.modes import Mode
from skyfolio.sim.wire import Message

MISSION_CURRENT = dialect.MAVLINK_MSG_ID_MISSION_CURRENT


class Px4Commands(Commands):
    """The command table of a PX4."""

    _message_first = True

    def __init__(self, host: CommandHost) -> None:
        super().__init__(host)
        self._table[dialect.MAV_CMD_INJECT_FAILURE] = self._inject_failure

    def set_mode_message(self, message: Any) -> list[Message]:
        """Obey a SET_MODE; PX4 acknowledges it as a command."""
        main, sub = message.custom_mode >> 16 & 0xFF, message.custom_mode >> 24
        custom = message.base_mode & dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
        mode = self._mode_of(main, sub) if custom else None
        result = UNSUPPORTED if mode is None else self._mode(mode).result
        ack: Message = dialect.MAVLink_command_ack_message(dialect.MAV_CMD_DO_SET_MODE, result)
        return [ack]

    def _arm_disarm(self, command: Command) -> Outcome:
        if command.param1 == 1.0:
            done = self._host.arm()
        elif command.param1 == 0.0:
            done = self._host.disarm(force=command.param2 == FORCE)
            if not done:
                self._host.send_text("Disarming denied: not landed\t", dialect.MAV_SEVERITY_CRITICAL)
        else:
            return Outcome(UNSUPPORTED)
        return Outcome(ACCEPTED if done else REJECTED_FOR_NOW)

    def _takeoff(self, command: Command) -> Outcome:
        """Take off to param7, metres above sea level on PX4; without it, to MIS_TAKEOFF_ALT."""
        up_m = None if command.alt_m is None else command.alt_m - self._host.spec.home_alt_m
        self._host.takeoff(up_m if up_m is not None and up_m > 0.0 else None)
        return Outcome(ACCEPTED)

    def _set_mode(self, command: Command) -> Outcome:
        mode = self._mode_of(command.param2, command.param3)
        custom = command.param1 >= 0.0 and index_of(command.param1) & dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
        if not custom or mode is None:
            return Outcome(UNSUPPORTED)
        return self._mode(mode)

    def _mode_of(self, main: float, sub: float) -> Mode | None:
        """Return the mode of PX4's main and sub mode, or None if there is no such mode here."""
        modes = self._host.traits.custom_modes.items()
        return next((mode for mode, custom in modes if (custom >> 16 & 0xFF, custom >> 24) == (main, sub)), None)

    def _mode(self, mode: Mode) -> Outcome:
        return Outcome(ACCEPTED if self._host.set_mode(mode) else REJECTED_FOR_NOW)

    def _change_speed(self, command: Command) -> Outcome:
        """Set the speed, in any mode, RTL too; the next mode forgets it."""
        if not math.isfinite(command.param2):
            return Outcome(DENIED)
        speed_mps = command.param2 if command.param2 > 0.0 else None
        self._host.runner.speed_mps = self._host.navigator.speed_mps = speed_mps
        return Outcome(ACCEPTED)

    def _reboot(self, command: Command) -> Outcome:
        """Reboot if param1 is 1 or 3, do nothing if it is 0; refuse while armed."""
        if command.param1 == 0.0:
            return Outcome(ACCEPTED)
        if command.param1 not in (1.0, 3.0) or self._host.armed:
            return Outcome(DENIED)
        self._host.component_failures.request_reboot()
        return Outcome(ACCEPTED)

    def _reposition(self, command: Command) -> Outcome:
        place = self._place(command)
        if place is None:
            return Outcome(DENIED)
        self._host.reposition(*place, command.param1)
        return Outcome(ACCEPTED)

    def _mission_start(self, command: Command) -> Outcome:
        """Start at item param1 and arm, as PX4 does."""
        if not self._host.runner.mission.items:
            self._host.send_text("Mission start denied! No valid mission\t", dialect.MAV_SEVERITY_CRITICAL)
            return Outcome(DENIED)
        if not self._host.plans.jump(index_of(command.param1)) or not self._host.set_mode(Mode.MISSION):
            return Outcome(REJECTED_FOR_NOW)
        return Outcome(ACCEPTED if self._host.arm() else REJECTED_FOR_NOW)

    def _set_mission_current(self, command: Command) -> Outcome:
        """Refuse: PX4 has only the message MISSION_SET_CURRENT."""
        del command
        return Outcome(UNSUPPORTED)

    def _send(self, message_id: int) -> Outcome:
        """Send a requested message; MISSION_CURRENT cannot be requested, because it is not a stream on PX4."""
        return Outcome(DENIED) if message_id == MISSION_CURRENT else super()._send(message_id)

    def _set_message_interval(self, command: Command) -> Outcome:
        if index_of(command.param1) == MISSION_CURRENT:
            return Outcome(FAILED)
        return super()._set_message_interval(command)

    def _go_home(self, command: Command) -> Outcome:
        return self._announced(super()._go_home(command), "Returning to launch\t")

    def _land(self, command: Command) -> Outcome:
        return self._announced(super()._land(command), "Landing at current position\t")

    def _announced(self, outcome: Outcome, words: str) -> Outcome:
        if outcome.result == ACCEPTED:
            self._host.send_text(words)
        return outcome

    def _inject_failure(self, command: Command) -> Outcome:
        if not self._host.parameters.tuning.failures_enabled:
            return Outcome(DENIED)
        done = injected_failure(self._host.component_failures, index_of(command.param1), index_of(command.param2))
        return Outcome(ACCEPTED if done else UNSUPPORTED)
