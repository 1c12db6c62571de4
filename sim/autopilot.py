"""The autopilot of one vehicle: modes, arming, and the choice of where to fly next. PX4 flavour.

Pure: it is handed decoded MAVLink messages and time, and hands back messages; no sockets and no clock of its own, so a
test drives it in virtual time.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from sim.commands import Commands
from sim.geo import LocalFrame
from sim.lineup import VehicleSpec
from sim.mission_protocol import MissionProtocol
from sim.mission_runner import Handover, MissionRunner
from sim.missions import Mission
from sim.modes import Mode
from sim.parameters import ParameterStore
from sim.telemetry import Telemetry
from sim.vehicle import Body, Guidance, Limits, fall, step, stopping_point
from sim.wire import Message, is_for, text

RTL_MIN_DISTANCE_M = 5.0
"""Closer to home than this a return does not climb first (RTL_MIN_DIST)."""

Observer = Callable[[str, dict[str, Any]], None]


class Autopilot:
    """One vehicle's autopilot and airframe.

    `handle` answers a message, `step` flies, `due` tells what is to be sent to everybody. `on_event(kind, detail)`
    hears what really happens: armed, disarmed, mode, takeoff, landed, crashed, mission_accepted, item_reached.
    `protocol_clock` gives wall seconds for the protocol's time-outs; `phase` in [0, 1) spreads the streams of a fleet.
    """

    def __init__(
        self,
        spec: VehicleSpec,
        *,
        limits: Limits,
        protocol_clock: Callable[[], float],
        on_event: Observer,
        boot_s: float = 0.0,
        phase: float = 0.0,
    ) -> None:
        self.spec = spec
        self.frame = LocalFrame(spec.home_lat_deg, spec.home_lon_deg)
        self.parameters = ParameterStore(limits)
        self.body = Body()
        self.home_m = (0.0, 0.0)
        self.mode = Mode.HOLD
        self.armed = False
        self.powered = True
        self.crashed = False
        self.now_s = self.boot_s = boot_s
        self.flown_s = 0.0
        self.landing = False
        self._emit = on_event
        self._outbox: list[Message] = []
        self._hold: Guidance | None = None
        self._takeoff_up_m: float | None = None
        self._return_up_m: float | None = None
        self._landed_s: float | None = None
        self.runner = MissionRunner(self.frame, spec.home_alt_m, self.parameters, self._item_reached)
        self.missions = MissionProtocol(
            clock=protocol_clock, on_accept=self._mission_accepted, on_jump=self.jump, current=lambda: self.runner.index
        )
        self.telemetry = Telemetry(self, start_s=boot_s, phase=phase)
        self._commands = Commands(self)

    # -- talking ------------------------------------------------------------------------------------------------

    def handle(self, message: Any) -> list[Message]:
        """Return the answers to one incoming message, for its sender only; messages for other systems are ignored."""
        if not is_for(message, self.spec.system_id):
            return []
        name = message.get_type()
        if name in self.missions.messages:
            return self.missions.handle(message)
        if name in self.parameters.messages:
            return self.parameters.handle(message)
        if name in ("COMMAND_LONG", "COMMAND_INT"):
            return self._commands.handle(message)
        if name == "PING" and message.target_system == 0:
            who = (message.get_srcSystem(), message.get_srcComponent())
            return [dialect.MAVLink_ping_message(message.time_usec, message.seq, *who)]
        return []

    def due(self) -> list[Message]:
        """Return what is to be sent to everybody by now: announcements, protocol timers and telemetry streams."""
        announced, self._outbox = self._outbox, []
        return announced + self.missions.tick() + self.telemetry.due(self.now_s)

    def say(self, words: str, severity: int = dialect.MAV_SEVERITY_INFO) -> None:
        """Announce a STATUSTEXT."""
        self._outbox.append(text(words, severity))

    def announce(self, message_id: int) -> None:
        """Send a telemetry message now, beside its stream."""
        message = self.telemetry.build(message_id)
        if message is not None:
            self._outbox.append(message)

    # -- being commanded ----------------------------------------------------------------------------------------

    def arm(self) -> bool:
        """Arm where the vehicle stands, which becomes home; False if it cannot fly any more."""
        if self.crashed or not self.powered:
            return False
        if not self.armed:
            self.armed = True
            self._landed_s = None
            if self.mode in (Mode.LAND, Mode.RTL):
                self.set_mode(Mode.HOLD)
            if self.body.on_ground:
                self.home_m = (self.body.east_m, self.body.north_m)
                self.announce(dialect.MAVLINK_MSG_ID_HOME_POSITION)
            self._emit("armed", {})
        return True

    def disarm(self, *, force: bool = False) -> bool:
        """Disarm on the ground; in the air only by force, which stops the motors. False if refused."""
        if not self.armed:
            return True
        if not self.body.on_ground and not force:
            return False
        self.armed = False
        self.powered = self.body.on_ground
        if self.mode is Mode.MISSION and self.runner.complete:
            self.set_mode(Mode.HOLD)
        self._emit("disarmed", {})
        return True

    def set_mode(self, mode: Mode) -> bool:
        """Change the mode; False if it cannot be flown (no mission on board)."""
        if mode is Mode.MISSION and not self.runner.mission.items:
            self.say("Mission mode denied: no mission", dialect.MAV_SEVERITY_CRITICAL)
            return False
        if mode is Mode.MISSION and (self.mode is not Mode.MISSION or self.runner.complete):
            self.runner.activate()
        self._hold = self._stop_here()
        self._takeoff_up_m = self._return_up_m = None
        if mode is not self.mode:
            self.mode = mode
            self._emit("mode", {"mode": mode.name})
            self.announce(dialect.MAVLINK_MSG_ID_MISSION_CURRENT)
        return True

    def takeoff(self, up_m: float | None) -> bool:
        """Climb above this place to `up_m` above home (None: MIS_TAKEOFF_ALT), then hold."""
        self.set_mode(Mode.TAKEOFF)
        self._takeoff_up_m = up_m
        return True

    def reposition(self, east_m: float | None, north_m: float | None, up_m: float | None, speed_mps: float) -> bool:
        """Hold, at a given place and height if there is one; a speed <= 0 means the cruise speed."""
        self.set_mode(Mode.HOLD)
        if self._hold is None:
            return True
        here = self._hold
        self._hold = Guidance(
            here.east_m if east_m is None else east_m,
            here.north_m if north_m is None else north_m,
            here.up_m if up_m is None else up_m,
            speed_mps if speed_mps > 0.0 else here.speed_mps,
        )
        return True

    def jump(self, seq: int) -> bool:
        """Make mission item `seq` current; False if there is none."""
        if not 0 <= seq < len(self.runner.mission):
            return False
        self.runner.jump(seq)
        self.announce(dialect.MAVLINK_MSG_ID_MISSION_CURRENT)
        return True

    def cut_power(self) -> None:
        """Stop the motors for good."""
        self.powered = self.armed = False

    # -- flying -------------------------------------------------------------------------------------------------

    def step(self, now_s: float, dt_s: float) -> None:
        """Fly `dt_s`, to arrive at fleet time `now_s`."""
        self.now_s = now_s
        before = self.body
        if not self.powered:
            self.body = fall(before, dt_s)
        elif self.armed:
            guidance = self._guidance()
            self.landing = guidance is not None and guidance.landing
            if guidance is not None:
                self.body = step(before, guidance, self.parameters.limits, dt_s)
        self._notice(before)
        if not self.body.on_ground:
            self.flown_s += dt_s
        self._disarm_after_landing()

    def _guidance(self) -> Guidance | None:
        """Return where to fly, or None to stay on the ground with the motors idling."""
        if self.mode is Mode.MISSION:
            return self._mission_guidance()
        if self.mode is Mode.TAKEOFF:
            return self._takeoff_guidance()
        if self.body.on_ground or self._hold is None:
            return None
        if self.mode is Mode.LAND:
            return replace(self._hold, landing=True)
        return self._return_guidance() if self.mode is Mode.RTL else self._hold

    def _mission_guidance(self) -> Guidance | None:
        if self.runner.complete and self.body.on_ground:
            return None
        index = self.runner.index
        result = self.runner.fly(self.body, self.now_s)
        if index != self.runner.index or isinstance(result, Handover):
            self.announce(dialect.MAVLINK_MSG_ID_MISSION_CURRENT)
        if isinstance(result, Guidance):
            return result
        if result is not Handover.LANDED:
            self.set_mode(Mode.RTL if result is Handover.RETURN else Mode.HOLD)
            self.say("Mission finished")
        return None if self.body.on_ground else self._guidance()

    def _takeoff_guidance(self) -> Guidance | None:
        if self._hold is None:
            self._hold = self._here()
        if self._takeoff_up_m is None:
            self._takeoff_up_m = self.parameters["MIS_TAKEOFF_ALT"]
        up_m = max(self._takeoff_up_m, self._hold.up_m)
        guidance = replace(self._hold, up_m=up_m)
        if abs(up_m - self.body.up_m) <= self.parameters["NAV_MC_ALT_RAD"] / 2.0:
            self.set_mode(Mode.HOLD)
            self._hold = guidance
        return guidance

    def _return_guidance(self) -> Guidance:
        assert self._hold is not None  # noqa: S101
        speed_mps = self.parameters.limits.cruise_speed_mps
        distance_m = self.body.distance_to(*self.home_m)
        if self._return_up_m is None:
            climb = distance_m > RTL_MIN_DISTANCE_M
            self._return_up_m = max(self.body.up_m, self.parameters["RTL_RETURN_ALT"] if climb else 0.0)
        if self._hold.landing or distance_m <= self.parameters["NAV_ACC_RAD"]:
            self._hold = Guidance(*self.home_m, 0.0, speed_mps, landing=True)
            return self._hold
        if self._return_up_m - self.body.up_m > self.parameters["NAV_MC_ALT_RAD"]:
            return replace(self._hold, up_m=self._return_up_m)
        return Guidance(*self.home_m, self._return_up_m, speed_mps)

    def _stop_here(self) -> Guidance | None:
        """Return where the vehicle comes to rest when it brakes now; None on the ground."""
        if self.body.on_ground:
            return None
        east_m, north_m = stopping_point(self.body, self.parameters.limits)
        return replace(self._here(), east_m=east_m, north_m=north_m)

    def _here(self) -> Guidance:
        body, limits = self.body, self.parameters.limits
        return Guidance(body.east_m, body.north_m, body.up_m, max(limits.cruise_speed_mps, body.ground_speed_mps))

    # -- what happened ------------------------------------------------------------------------------------------

    def _notice(self, before: Body) -> None:
        if before.on_ground == self.body.on_ground:
            return
        self.announce(dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE)
        if before.on_ground:
            self._landed_s = None
            self._emit("takeoff", {})
        elif self.powered:
            self._landed_s = self.now_s
            self._hold = None
            self._emit("landed", {})
        else:
            self.crashed = True
            self._emit("crashed", {"impact_mps": round(math.fabs(before.up_mps), 2)})

    def _disarm_after_landing(self) -> None:
        wait_s = self.parameters["COM_DISARM_LAND"]
        if self.armed and wait_s >= 0.0 and self._landed_s is not None and self.now_s - self._landed_s >= wait_s:
            self.disarm()

    def _mission_accepted(self, mission: Mission) -> None:
        self.runner.load(mission, on_ground=self.body.on_ground)
        if self.mode is Mode.MISSION:
            self.runner.started = True
        self._emit("mission_accepted", {"mission_id": mission.mission_id, "items": mission.items})
        self.announce(dialect.MAVLINK_MSG_ID_MISSION_CURRENT)

    def _item_reached(self, seq: int) -> None:
        self._outbox.append(dialect.MAVLink_mission_item_reached_message(seq))
        self._emit("item_reached", {"seq": seq})
