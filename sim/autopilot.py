"""The autopilot of one vehicle: modes, arming, messages, and what really happens to it. Both flavours.

Pure: it is handed decoded MAVLink messages and time, and hands back messages; no sockets and no clock of its own, so a
test drives it in virtual time. `sim.flavours` says in what PX4 and ArduPilot differ.
"""

from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.sim.airframe import Battery
from skyfolio.sim.boot import Boot
from skyfolio.sim.chatter import Chatter
from skyfolio.sim.component_failures import Mishaps
from skyfolio.sim.dynamics import Dynamics
from skyfolio.sim.flavours import FLAVOURS
from skyfolio.sim.geo import LocalFrame, Place
from skyfolio.sim.ground import Ground
from skyfolio.sim.inbox import Inbox
from skyfolio.sim.kinematics import Body, Limits
from skyfolio.sim.metadata import metadata_files
from skyfolio.sim.modes import Mode
from skyfolio.sim.navigator import Navigator
from skyfolio.sim.onboard_plans import Plans
from skyfolio.sim.parameter_store import ParameterStore
from skyfolio.sim.setpoints import Setpoint
from skyfolio.sim.specs import VehicleSpec
from skyfolio.sim.telemetry_streams import Telemetry
from skyfolio.sim.weather import Air, Weather
from skyfolio.sim.wire import Message, texts

Observer = Callable[[str, dict[str, Any]], None]
_FORGOTTEN_MODES = (Mode.TAKEOFF, Mode.RTL, Mode.LAND)
"""Modes a PX4 does not come back to once it has disarmed: it could not be armed in them."""
NOON_S = 12 * 3600.0
"""UTC time of day at fleet time 0."""


class Autopilot:
    """One vehicle's autopilot and airframe.

    `handle` answers a message, `step` flies, `due` tells what is to be sent to everybody. `on_event(kind, detail)`
    hears what really happens (kinds: see `sim.truth.Event`). `protocol_clock` gives wall seconds for the protocol's
    time-outs; `phase` in [0, 1) spreads the streams of a fleet. `limits` None: the flavour's own. `now_s`: when its
    life in the fleet begins; it was switched on `spec.booted_s_ago` before.
    """

    def __init__(
        self,
        spec: VehicleSpec,
        *,
        protocol_clock: Callable[[], float],
        on_event: Observer,
        limits: Limits | None = None,
        now_s: float = 0.0,
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
        self.now_s = now_s
        self.clock_offset_s = 0.0
        self.mishaps = Mishaps(self)
        self._outbox: list[Message] = []
        self._texts = 0
        self.runner = flavour.runner(
            self.frame,
            spec.home_alt_m,
            self.parameters,
            self._item_reached,
            utc=self.utc_s,
            say=self.say,
            on_speed=self._mission_speed,
        )
        self.missions = flavour.missions(clock=protocol_clock, host=self.plans)
        self._boot(now_s - spec.booted_s_ago)

    def _boot(self, boot_s: float) -> None:
        """Start afresh; parameters, plans and the airframe stay as they are."""
        self.boot_s = boot_s
        self.mode = self._mode_to_come = self.flavour.boot_mode
        self.boot_plan = Boot(self)
        self.chatter = Chatter(self)
        self._reached: int | None = None
        self.cleared_for_takeoff = not self.flavour.needs_clearance
        self.ground = Ground(self)
        self.navigator = Navigator(self)
        self.failsafes = self.flavour.failsafes(self)
        self.telemetry = Telemetry(self, start_s=self.now_s, phase=self.phase)
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
        return self.dynamics.satellites and self.boot_plan.ready

    @property
    def landed(self) -> bool:
        """Whether it thinks that it stands on the ground: a vehicle that is not armed does, wherever it is."""
        return not self.armed or self.body.on_ground

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
        announced += self.telemetry.mission_news(self._reached)
        self._reached = None
        return announced + self.chatter.due() + self.missions.tick() + self.telemetry.due(self.now_s)

    def say(self, words: str, severity: int = dialect.MAV_SEVERITY_INFO) -> None:
        """Announce a STATUSTEXT, in parts where it is long."""
        self._texts = self._texts % 0xFFFF + 1
        self._outbox += texts(words, severity, self._texts)

    def announce(self, message_id: int) -> None:
        """Send a telemetry message now, beside its stream."""
        message = self.telemetry.build(message_id)
        if message is not None:
            self._outbox.append(message)

    # -- being commanded ----------------------------------------------------------------------------------------

    def arm(self, *, force: bool = False) -> bool:
        """Arm where the vehicle stands, which becomes home; False if its checks forbid it, which it says."""
        if self.armed:
            return True
        refusal = self.flavour.arming_refusal(self, force=force)
        for words, severity in refusal:
            self.say(words, severity)
        if refusal:
            return False
        self.armed = True
        self.ground.armed()
        self.cleared_for_takeoff = not self.flavour.needs_clearance or self.parameters.tuning.takeoff_without_throttle
        self.say(self.flavour.words.armed)
        if self.body.on_ground:
            self.set_home_here()
        self.announce(dialect.MAVLINK_MSG_ID_HEARTBEAT)
        self.emit("armed", {})
        return True

    def set_home_here(self) -> None:
        """Make this place home, and tell it."""
        self.home_m = (self.body.east_m, self.body.north_m)
        self.announce(dialect.MAVLINK_MSG_ID_HOME_POSITION)

    def disarm(self, *, force: bool = False, words: str | None = None) -> bool:
        """Disarm on the ground; in the air only by force, which stops the motors. False if refused.

        `words`: what it says then, instead of that somebody told it to.
        """
        if not self.armed:
            return True
        if not self.body.on_ground and not force:
            return False
        self.armed = False
        self.dynamics.powered = self.dynamics.powered and self.body.on_ground
        self.say(words or self.flavour.words.disarmed)
        if self.mode is Mode.MISSION:
            self.chatter.mission_disarmed()
        self.runner.rewind()
        self.failsafes.disarmed()
        self.emit("disarmed", {})
        if self.flavour.restores_mode:
            if self.mode is not self._mode_to_come:
                self.set_mode(self._mode_to_come)
            if self.body.on_ground:
                self.set_home_here()
        return True

    def set_mode(self, mode: Mode, *, by_failsafe: bool = False) -> bool:
        """Change the mode; False if it cannot be flown, which it says. `by_failsafe`: nobody chose it."""
        refusal = self.flavour.mode_refusal(self, mode)
        for words, severity in refusal:
            self.say(words, severity)
        if refusal:
            return False
        if not by_failsafe:
            self.failsafes.taken_over()
            if mode not in _FORGOTTEN_MODES:
                self._mode_to_come = mode
        if mode is Mode.MISSION and (self.mode is not Mode.MISSION or self.runner.complete):
            self.runner.activate()
            if self.armed and self.flavour.words.mission_entered:
                self.say(self.flavour.words.mission_entered)
        elif mode is not Mode.MISSION and self.mode is Mode.MISSION:
            self.runner.leave()
            self.chatter.mission_left(to_return=self.runner.ends_with_return)
        self.navigator.enter(mode)
        if mode is not self.mode:
            self.mode = mode
            self.emit("mode", {"mode": mode.name})
            if self.flavour.beats_on_mode:
                self.announce(dialect.MAVLINK_MSG_ID_HEARTBEAT)
        return True

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
        self.telemetry.keep_to_itself()
        return True

    def start_mission(self) -> None:
        """Let the mission begin, or go on after it was over or halted (ArduCopter's MISSION_START in AUTO)."""
        self.cleared_for_takeoff = True
        if self.runner.over:
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
        """Come up again; it stands on the ground, or is still falling and does not know."""
        self.runner.forget_flight()
        self.now_s = now_s
        self.clock_offset_s = 0.0
        self._outbox.clear()
        self._boot(now_s)
        self.runner.load(self.missions.mission, on_ground=True)

    def thaw(self, frozen_s: float, frozen_wall_s: float) -> None:
        """Go on after a hang as if nothing had been: its clock and its timers stood still."""
        self.boot_s += frozen_s
        self.navigator.thaw(frozen_s)
        self.failsafes.thaw(frozen_wall_s)

    def coast(self, now_s: float, dt_s: float) -> None:
        """Let the airframe go on for `dt_s` without its autopilot, which hangs or boots."""
        was_on_ground, sinking_mps = self.body.on_ground, self.body.up_mps
        self.dynamics.drift(dt_s)
        if not was_on_ground and self.body.on_ground:
            self.now_s = now_s
            self.ground.notice(sinking_mps, took_off=False)

    # -- flying -------------------------------------------------------------------------------------------------

    def step(self, now_s: float, dt_s: float) -> None:
        """Fly `dt_s`, to arrive at fleet time `now_s`."""
        self.now_s = now_s
        was_on_ground, sinking_mps = self.body.on_ground, self.body.up_mps
        self.dynamics.step(now_s, dt_s)
        if was_on_ground != self.body.on_ground:
            self.ground.notice(sinking_mps, took_off=was_on_ground)
        self.boot_plan.step()
        self.ground.disarm_when_idle()
        self.failsafes.check(now_s, self.protocol_clock())

    def _mission_speed(self, speed_mps: float | None) -> None:
        if speed_mps is not None:
            self.chatter.speed_changed(speed_mps)

    def _item_reached(self, seq: int) -> None:
        self._reached = self.runner.reached = seq
        self.emit("item_reached", {"seq": seq})
