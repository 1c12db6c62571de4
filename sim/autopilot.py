"""The autopilot of one vehicle, of either flavour: puts its parts together, arms, and changes the mode.

Pure: it takes decoded MAVLink messages and time, and returns messages. It has no sockets and no clock of its own, so a
test drives it in virtual time. `sim.flavours` says in what PX4 and ArduPilot differ.
"""

from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.sim.airframe import Battery
from skyfolio.sim.boot import Boot
from skyfolio.sim.chatter import Chatter
from skyfolio.sim.component_failures import ComponentFailures
from skyfolio.sim.dynamics import Dynamics
from skyfolio.sim.flavours import FLAVOURS
from skyfolio.sim.gauge import Gauge
from skyfolio.sim.geo import LocalFrame, Place
from skyfolio.sim.ground import Ground
from skyfolio.sim.hosts import Refusal
from skyfolio.sim.inbox import Inbox
from skyfolio.sim.kinematics import Body, Limits
from skyfolio.sim.land import Hills, Land, Level
from skyfolio.sim.metadata import metadata_files
from skyfolio.sim.mission_protocol import MissionProtocol
from skyfolio.sim.mission_runner import MissionRunner
from skyfolio.sim.modes import Mode
from skyfolio.sim.navigator import Navigator
from skyfolio.sim.onboard_clock import OnboardClock
from skyfolio.sim.onboard_plans import Plans
from skyfolio.sim.outbox import Outbox
from skyfolio.sim.parameter_store import ParameterStore
from skyfolio.sim.specs import VehicleSpec
from skyfolio.sim.telemetry_streams import Telemetry
from skyfolio.sim.traits import Traits
from skyfolio.sim.weather import Air, Weather
from skyfolio.sim.wire import Message

Observer = Callable[[str, dict[str, Any]], None]
_FORGOTTEN_MODES = (Mode.TAKEOFF, Mode.RTL, Mode.LAND)
"""Modes to which a PX4 does not come back once it has disarmed: it could not be armed in them."""


class Autopilot:
    """One vehicle's autopilot and airframe.

    `handle` answers a message, `step` flies, and `due` returns what is to be sent to everybody. `on_event(kind,
    detail)` is called with what really happens (kinds: see `sim.truth.Event`). `protocol_clock` gives wall seconds for
    the protocol's time-outs; `phase` in [0, 1) spreads the streams of a fleet. `limits` None takes the flavour's own.
    `hills`: the ground, where it is not level. `now_s` is the fleet time at which the vehicle joins; it was switched on
    `spec.booted_s_ago` seconds before.
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
        hills: Hills | None = None,
    ) -> None:
        self.spec = spec
        self._flavour = flavour = FLAVOURS[spec.autopilot]
        self.traits: Traits = flavour
        self.frame = LocalFrame(spec.home_lat_deg, spec.home_lon_deg)
        parameters = flavour.parameters(limits or flavour.limits)
        self.files = metadata_files(parameters) if flavour.has_metadata else {}
        self.parameters = ParameterStore(parameters, flavour.tuning, bytewise=flavour.bytewise)
        self.parameters[flavour.capacity_parameter] = spec.battery_mah
        for name, value in spec.parameters:
            if name in self.parameters:
                self.parameters[name] = value
        self.clock = OnboardClock(now_s, spec.booted_s_ago)
        self.air = air or Air(Weather(), "calm")
        self.land: Land = Level() if hills is None else hills.around(self.frame, spec.home_alt_m)
        self.battery = Battery()
        self.dynamics = Dynamics(self)
        self.component_failures = ComponentFailures(self)
        self.plans = Plans(self)
        self.chatter = Chatter(spec.system_id, self.clock, gives_orders=flavour.gives_orders)
        self.protocol_clock = protocol_clock
        self.emit = on_event
        self.home_m: Place = (0.0, 0.0)
        self.armed = False
        self._phase = phase
        self._outbox = Outbox()
        self.runner: MissionRunner = flavour.runner(
            self.frame,
            spec.home_alt_m,
            self.parameters,
            self._item_reached,
            utc=self.clock.utc_s,
            send_text=self.send_text,
            on_speed=self.chatter.speed_changed,
        )
        self.missions: MissionProtocol = flavour.missions(clock=protocol_clock, host=self.plans)
        self._start()

    def _start(self) -> None:
        """Start afresh; parameters, plans and the airframe stay as they are."""
        flavour = self._flavour
        self.mode = self._mode_to_restore = flavour.boot_mode
        self.boot_plan = Boot(self, flavour.boot)
        self.chatter.reset()
        self.gauge = Gauge(self.battery, counts_only=flavour.counts_charge)
        self.navigator = Navigator(self, self.plans.return_point)
        self.ground = Ground(self)
        self.failsafes = flavour.failsafes(self, self.plans.fence)
        self.telemetry = Telemetry(self, start_s=self.now_s, phase=self._phase)
        self._inbox = Inbox(self, flavour.commands(self))

    # -- what it knows ------------------------------------------------------------------------------------------

    @property
    def now_s(self) -> float:
        """Fleet time of the last step, in seconds."""
        return self.clock.now_s

    @property
    def body(self) -> Body:
        """Where the vehicle truly is."""
        return self.dynamics.body

    @property
    def seen(self) -> Body:
        """Where the vehicle believes that it is."""
        return self.dynamics.seen

    @property
    def satellites(self) -> bool:
        """Whether the position is known."""
        return self.dynamics.satellites and self.boot_plan.ready

    @property
    def landed(self) -> bool:
        """Whether the autopilot believes that the vehicle stands on the ground: disarmed it does, wherever it is."""
        return not self.armed or self.body.on_ground

    def arming_refusal(self, *, force: bool = False, tag: str = "Arm") -> Refusal:
        """Return why the vehicle does not arm, in texts that begin with `tag` where the flavour's have one."""
        return self._flavour.arming_refusal(self, force=force, tag=tag)

    # -- sending and receiving ----------------------------------------------------------------------------------

    def handle(self, message: Any) -> list[Message]:
        """Return the answers to one incoming message, for its sender only; messages for other systems are ignored."""
        return self._inbox.handle(message)

    def due(self) -> list[Message]:
        """Return what is to be sent to everybody by now: announcements, protocol timers and telemetry streams."""
        messages = self._outbox.take()
        messages += self.telemetry.mission_news()
        messages += self.chatter.due()
        messages += self.missions.tick()
        messages += self.telemetry.due(self.clock.now_s)
        return messages

    def send_text(self, words: str, severity: int = dialect.MAV_SEVERITY_INFO) -> None:
        """Send a STATUSTEXT of a MAV_SEVERITY, in parts where it is long."""
        self._outbox.send_text(words, severity)

    def announce(self, message_id: int) -> None:
        """Send a telemetry message now, beside its stream."""
        self._outbox.add(self.telemetry.build(message_id))

    # -- being commanded ----------------------------------------------------------------------------------------

    def arm(self, *, force: bool = False) -> bool:
        """Arm where the vehicle stands, which becomes home; return False if its checks forbid it, and send why."""
        if self.armed:
            return True
        refusal = self.arming_refusal(force=force)
        for words, severity in refusal:
            self.send_text(words, severity)
        if refusal:
            return False
        self.armed = True
        self.ground.armed()
        self.navigator.armed()
        self.send_text(self.traits.words.armed)
        if self.body.on_ground:
            self.set_home_here()
        self.announce(dialect.MAVLINK_MSG_ID_HEARTBEAT)
        self.emit("armed", {})
        return True

    def set_home_here(self) -> None:
        """Make the present place home, and send it."""
        self.home_m = (self.body.east_m, self.body.north_m)
        self.announce(dialect.MAVLINK_MSG_ID_HOME_POSITION)

    def disarm(self, *, force: bool = False, words: str | None = None) -> bool:
        """Disarm on the ground; in the air only by force, which stops the motors. Return False if refused.

        `words`: the STATUSTEXT to send instead of the one for an order from outside.
        """
        if not self.armed:
            return True
        if not self.body.on_ground and not force:
            return False
        self.armed = False
        self.dynamics.powered = self.dynamics.powered and self.body.on_ground
        self.send_text(words or self.traits.words.disarmed)
        if self.mode is Mode.MISSION:
            self.chatter.mission_disarmed()
        self.runner.rewind()
        self.failsafes.disarmed()
        self.emit("disarmed", {})
        if self.traits.restores_mode:
            if self.mode is not self._mode_to_restore:
                self.set_mode(self._mode_to_restore)
            if self.body.on_ground:
                self.set_home_here()
        return True

    def set_mode(self, mode: Mode, *, by_failsafe: bool = False) -> bool:
        """Change the mode; return False if it cannot be flown, and send why. `by_failsafe`: it was not chosen."""
        refusal = self._flavour.mode_refusal(self, mode)
        for words, severity in refusal:
            self.send_text(words, severity)
        if refusal:
            return False
        if not by_failsafe:
            self.failsafes.taken_over()
            if mode not in _FORGOTTEN_MODES:
                self._mode_to_restore = mode
        self._enter_or_leave_mission(mode)
        self.navigator.enter(mode)
        if mode is not self.mode:
            self.mode = mode
            self.emit("mode", {"mode": mode.name})
            if self.traits.announces_mode:
                self.announce(dialect.MAVLINK_MSG_ID_HEARTBEAT)
        return True

    def _enter_or_leave_mission(self, mode: Mode) -> None:
        if mode is Mode.MISSION and (self.mode is not Mode.MISSION or self.runner.complete):
            self.runner.activate()
            if self.armed and self.traits.words.mission_entered:
                self.send_text(self.traits.words.mission_entered)
        elif mode is not Mode.MISSION and self.mode is Mode.MISSION:
            self.runner.leave()
            self.chatter.mission_left(to_return=self.runner.ends_with_return)

    def takeoff(self, up_m: float | None) -> None:
        """Climb above this place to `up_m` metres above home (None: to the take-off parameter), then hold."""
        if Mode.TAKEOFF in self.traits.custom_modes:
            self.set_mode(Mode.TAKEOFF)
        self.navigator.take_off(up_m)

    def reposition(self, east_m: float | None, north_m: float | None, up_m: float | None, speed_mps: float) -> None:
        """Hold at a place and height (metres; None keeps the present one); a speed <= 0 means the cruise speed."""
        self.set_mode(Mode.HOLD if self.traits.guided_needs_stream else Mode.GUIDED)
        self.navigator.go_to(east_m, north_m, up_m, speed_mps)

    # -- being switched off and on --------------------------------------------------------------------------------

    def shut_down(self) -> None:
        """Go down for a reboot: stop the motors and forget the transfers under way."""
        self.armed = False
        self.dynamics.powered = self.body.on_ground and not self.dynamics.crashed
        self.missions.reset()

    def boot(self, now_s: float) -> None:
        """Start again at fleet time `now_s`; the vehicle stands on the ground, or still falls without knowing it."""
        self.runner.forget_flight()
        self.clock.restart(now_s)
        self._outbox.clear()
        self._start()
        self.runner.load(self.missions.mission, on_ground=True)

    def thaw(self, frozen_s: float, frozen_wall_s: float) -> None:
        """Go on after a hang of so many seconds of fleet time and of wall time; clock and timers stood still in it."""
        self.clock.thaw(frozen_s)
        self.navigator.thaw(frozen_s)
        self.failsafes.thaw(frozen_wall_s)

    def coast(self, now_s: float, dt_s: float) -> None:
        """Move the airframe for `dt_s` seconds, to fleet time `now_s`, while its autopilot hangs or boots."""
        was_on_ground, sinking_mps = self.body.on_ground, self.body.up_mps
        self.dynamics.drift(dt_s)
        if not was_on_ground and self.body.on_ground:
            self.clock.now_s = now_s
            self.ground.touched(sinking_mps)

    # -- flying -------------------------------------------------------------------------------------------------

    def step(self, now_s: float, dt_s: float) -> None:
        """Fly for `dt_s` seconds, to arrive at fleet time `now_s`."""
        self.clock.now_s = now_s
        dynamics = self.dynamics
        before = dynamics.body
        dynamics.step(now_s, dt_s)
        on_ground = dynamics.body.on_ground
        if on_ground is not before.on_ground:
            if on_ground:
                self.ground.touched(before.up_mps)
            else:
                self.ground.took_off()
        self.boot_plan.step()
        if self.armed:
            self.ground.disarm_when_idle()
        self.failsafes.check(now_s, self.protocol_clock())

    @property
    def rests(self) -> bool:
        """Whether nothing can move: it stands on the ground, whole, disarmed, and started long ago."""
        dynamics = self.dynamics
        return (
            not self.armed
            and self.boot_plan.is_over
            and dynamics.body.on_ground
            and dynamics.powered
            and dynamics.satellites
            and not dynamics.crashed
        )

    def rest(self, now_s: float, for_s: float) -> None:
        """Let `for_s` seconds pass, until fleet time `now_s`, for a vehicle that `rests`."""
        self.clock.now_s = now_s
        self.dynamics.stand(now_s, for_s)
        self.failsafes.check(now_s, self.protocol_clock())

    @property
    def next_due_s(self) -> float:
        """When it has something to send next, unless something happens to it before; fleet seconds."""
        if self._outbox or self.missions.busy:
            return self.clock.now_s
        return min(self.telemetry.next_s, self.chatter.next_s)

    def _item_reached(self, seq: int) -> None:
        self.runner.reached = seq
        self.telemetry.item_reached(seq)
        self.emit("item_reached", {"seq": seq})
