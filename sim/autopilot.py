"""The autopilot of one vehicle: modes, arming, messages, and what really happens to it. Both flavours.

Pure: it is handed decoded MAVLink messages and time, and hands back messages; no sockets and no clock of its own, so a
test drives it in virtual time. `sim.flavours` says in what PX4 and ArduPilot differ.
"""

import math
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from sim.airframe import Battery
from sim.dynamics import Dynamics
from sim.failsafes import Failsafes
from sim.flavours import FLAVOURS
from sim.geo import LocalFrame, Place
from sim.inbox import Inbox
from sim.lineup import VehicleSpec
from sim.metadata import metadata_files
from sim.mishaps import Mishaps
from sim.modes import Mode
from sim.navigator import Navigator
from sim.parameters import ParameterStore
from sim.plans import Plans
from sim.setpoints import Setpoint
from sim.telemetry import Telemetry
from sim.vehicle import Body, Limits
from sim.weather import Air, Weather
from sim.wire import Message, text

Observer = Callable[[str, dict[str, Any]], None]
NOON_S = 12 * 3600.0
"""UTC time of day at fleet time 0."""


class Autopilot:
    """One vehicle's autopilot and airframe.

    `handle` answers a message, `step` flies, `due` tells what is to be sent to everybody. `on_event(kind, detail)`
    hears what really happens (kinds: see `sim.truth.Event`). `protocol_clock` gives wall seconds for the protocol's
    time-outs; `phase` in [0, 1) spreads the streams of a fleet. `limits` None: the flavour's own.
    """

    def __init__(
        self,
        spec: VehicleSpec,
        *,
        protocol_clock: Callable[[], float],
        on_event: Observer,
        limits: Limits | None = None,
        boot_s: float = 0.0,
        phase: float = 0.0,
        air: Air | None = None,
    ) -> None:
        self.spec = spec
        self.flavour = flavour = FLAVOURS[spec.autopilot]
        self.frame = LocalFrame(spec.home_lat_deg, spec.home_lon_deg)
        known = flavour.parameters(limits or flavour.limits)
        self.files = metadata_files(known) if flavour.has_metadata else {}
        self.parameters = ParameterStore(known, flavour.tuning, bytewise=flavour.bytewise)
        self.air = air or Air(Weather(), "calm")
        self.battery = Battery()
        self.dynamics = Dynamics(self)
        self.plans = Plans(self)
        self.protocol_clock = protocol_clock
        self.emit = on_event
        self.phase = phase
        self.home_m: Place = (0.0, 0.0)
        self.armed = False
        self.now_s = boot_s
        self.clock_offset_s = 0.0
        self.mishaps = Mishaps(self)
        self._outbox: list[Message] = []
        self.runner = flavour.runner(
            self.frame, spec.home_alt_m, self.parameters, self._item_reached, utc=self.utc_s, say=self.say
        )
        self.missions = flavour.missions(clock=protocol_clock, host=self.plans)
        self._boot(boot_s)

    def _boot(self, now_s: float) -> None:
        """Start afresh; parameters, plans and the airframe stay as they are."""
        self.boot_s = now_s
        self.mode = self.flavour.boot_mode
        self.cleared_for_takeoff = not self.flavour.needs_clearance
        self._armed_s = self._landed_s = math.inf
        self.navigator = Navigator(self)
        self.failsafes = Failsafes(self)
        self.telemetry = Telemetry(self, start_s=now_s, phase=self.phase)
        self._inbox = Inbox(self)

    # -- what it knows ------------------------------------------------------------------------------------------

    @property
    def body(self) -> Body:
        """Where the vehicle truly is."""
        return self.dynamics.body

    @property
    def seen(self) -> Body:
        """Where the vehicle believes to be."""
        return self.dynamics.seen

    @property
    def crashed(self) -> bool:
        """Whether it has hit the ground without power."""
        return self.dynamics.crashed

    @property
    def satellites(self) -> bool:
        """Whether the position is known."""
        return self.dynamics.satellites

    def utc_s(self, now_s: float) -> float:
        """Return seconds since midnight UTC at a moment of fleet time."""
        return (now_s + NOON_S + self.clock_offset_s) % 86_400.0

    # -- talking ------------------------------------------------------------------------------------------------

    def handle(self, message: Any) -> list[Message]:
        """Return the answers to one incoming message, for its sender only; messages for other systems are ignored."""
        return self._inbox.handle(message)

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

    def announce_progress(self) -> None:
        """Send MISSION_CURRENT now, if that is this autopilot's way."""
        if self.runner.announces:
            self.announce(dialect.MAVLINK_MSG_ID_MISSION_CURRENT)

    # -- being commanded ----------------------------------------------------------------------------------------

    def arm(self) -> bool:
        """Arm where the vehicle stands, which becomes home; False if it cannot fly any more or knows no position."""
        if self.crashed or not self.dynamics.powered:
            return False
        if not self.armed and not self.satellites:
            self.say("Arming denied: no position", dialect.MAV_SEVERITY_CRITICAL)
            return False
        if not self.armed:
            self.armed = True
            self._armed_s, self._landed_s = self.now_s, math.inf
            self.cleared_for_takeoff = (
                not self.flavour.needs_clearance or self.parameters.tuning.takeoff_without_throttle
            )
            if self.mode in (Mode.LAND, Mode.RTL):
                self.set_mode(Mode.HOLD)
            if self.body.on_ground:
                self.home_m = (self.body.east_m, self.body.north_m)
                self.announce(dialect.MAVLINK_MSG_ID_HOME_POSITION)
            self.emit("armed", {})
        return True

    def disarm(self, *, force: bool = False) -> bool:
        """Disarm on the ground; in the air only by force, which stops the motors. False if refused."""
        if not self.armed:
            return True
        if not self.body.on_ground and not force:
            return False
        self.armed = False
        self.dynamics.powered = self.dynamics.powered and self.body.on_ground
        if self.mode is Mode.MISSION and self.runner.complete and self.flavour.leaves_mission_at_end:
            self.set_mode(Mode.HOLD)
        self.runner.rewind()
        self.emit("disarmed", {})
        return True

    def set_mode(self, mode: Mode) -> bool:
        """Change the mode; False if it cannot be flown: no mission that can start, no position, no setpoints."""
        reason = self._cannot_enter(mode)
        if reason:
            self.say(reason, dialect.MAV_SEVERITY_CRITICAL)
            return False
        if mode is Mode.MISSION and (self.mode is not Mode.MISSION or self.runner.complete):
            self.runner.activate()
        elif mode is not Mode.MISSION and self.mode is Mode.MISSION:
            self.runner.leave()
        self.navigator.enter(mode)
        if mode is not self.mode:
            self.mode = mode
            self.emit("mode", {"mode": mode.name})
            self.announce_progress()
        return True

    def _cannot_enter(self, mode: Mode) -> str | None:
        if mode not in self.flavour.custom_modes:
            return f"{mode.name} mode denied: no such mode"
        if mode.needs_position and not self.satellites:
            return f"{mode.name} mode denied: no position"
        if mode is Mode.MISSION:
            return self.runner.can_start(on_ground=self.armed and self.body.on_ground)
        if mode is Mode.GUIDED and self.flavour.guided_needs_stream and self.navigator.setpoint is None:
            return "Offboard mode denied: no setpoints"
        return None

    def takeoff(self, up_m: float | None) -> bool:
        """Climb above this place to `up_m` above home (None: the take-off parameter), then hold."""
        if Mode.TAKEOFF in self.flavour.custom_modes:
            self.set_mode(Mode.TAKEOFF)
        self.navigator.take_off(up_m)
        return True

    def reposition(self, east_m: float | None, north_m: float | None, up_m: float | None, speed_mps: float) -> bool:
        """Hold, at a given place and height if there is one; a speed <= 0 means the cruise speed."""
        self.set_mode(Mode.HOLD if self.flavour.guided_needs_stream else Mode.GUIDED)
        self.navigator.go_to(east_m, north_m, up_m, speed_mps)
        return True

    def follow(self, setpoint: Setpoint) -> None:
        """Take a streamed setpoint; it counts in GUIDED, and opens the way there where one is needed for it."""
        if self.mode is Mode.GUIDED or self.flavour.guided_needs_stream:
            self.navigator.setpoint = setpoint

    def jump(self, seq: int) -> bool:
        """Make mission item `seq` current, without a word; False if there is none."""
        if not self.runner.can_jump(seq):
            return False
        self.runner.jump(seq)
        return True

    def start_mission(self) -> None:
        """Let the mission begin, or go on after it was over or halted (ArduCopter's MISSION_START in AUTO)."""
        self.cleared_for_takeoff = True
        if self.runner.state(flying=True).name != "ACTIVE":
            self.runner.activate()

    def pause(self, *, paused: bool) -> bool:
        """Stop or go on within AUTO or GUIDED; False in any other mode."""
        if self.mode not in (Mode.MISSION, Mode.GUIDED):
            return False
        self.navigator.pause(paused=paused)
        return True

    # -- being switched off and on --------------------------------------------------------------------------------

    def shut_down(self) -> None:
        """Go down for a reboot: motors off, transfers forgotten."""
        self.armed = False
        self.dynamics.powered = self.body.on_ground and not self.crashed
        self.missions.reset()

    def boot(self, now_s: float) -> None:
        """Come up again; it stands on the ground, or is still falling."""
        self.runner.rewind()
        self.now_s = now_s
        self.clock_offset_s = 0.0
        self._outbox.clear()
        self._boot(now_s)
        self.runner.load(self.missions.mission, on_ground=True)

    def coast(self, now_s: float, dt_s: float) -> None:
        """Let the airframe go on for `dt_s` without its autopilot, which hangs or boots."""
        was_on_ground, sinking_mps = self.body.on_ground, self.body.up_mps
        self.dynamics.drift(dt_s)
        if not was_on_ground and self.body.on_ground:
            self.now_s = now_s
            self._notice(sinking_mps, took_off=False)

    # -- flying -------------------------------------------------------------------------------------------------

    def step(self, now_s: float, dt_s: float) -> None:
        """Fly `dt_s`, to arrive at fleet time `now_s`."""
        self.now_s = now_s
        was_on_ground, sinking_mps = self.body.on_ground, self.body.up_mps
        self.dynamics.step(now_s, dt_s)
        if was_on_ground != self.body.on_ground:
            self._notice(sinking_mps, took_off=was_on_ground)
        self._disarm_when_idle()
        if self.dynamics.powered:
            self.failsafes.check(now_s, self.protocol_clock())

    def _notice(self, sinking_mps: float, *, took_off: bool) -> None:
        self.announce(dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE)
        if took_off:
            self._landed_s = self._armed_s = math.inf
            self.emit("takeoff", {})
        elif self.dynamics.powered:
            self._landed_s = self.now_s
            self.navigator.settle()
            self.emit("landed", {})
        else:
            self.dynamics.crashed = True
            self.emit("crashed", {"impact_mps": round(abs(sinking_mps), 2)})

    def _disarm_when_idle(self) -> None:
        if not self.armed:
            return
        tuning = self.parameters.tuning
        waits = ((self._landed_s, tuning.disarm_after_landing_s), (self._armed_s, tuning.disarm_on_ground_s))
        if any(wait_s is not None and self.now_s - since_s >= wait_s for since_s, wait_s in waits):
            self.disarm()

    def _item_reached(self, seq: int) -> None:
        self._outbox.append(dialect.MAVLink_mission_item_reached_message(seq))
        self.emit("item_reached", {"seq": seq})
