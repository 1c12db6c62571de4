"""The vehicle as its parts see it: small protocols, so that no part knows the whole autopilot.

Each part names what it needs in a protocol of its own beside it (`NavigatorHost`, `FailsafeHost`, ...), made from
these; `sim.autopilot.Autopilot` satisfies all of them. Only `sim.autopilot` puts the parts together.
"""

from typing import Any, Protocol

from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.sim.airframe import Battery
from skyfolio.sim.dynamics import Dynamics
from skyfolio.sim.gauge import Gauge
from skyfolio.sim.geo import LocalFrame, Place
from skyfolio.sim.kinematics import Body
from skyfolio.sim.mission_runner import MissionRunner
from skyfolio.sim.modes import Mode
from skyfolio.sim.onboard_clock import OnboardClock
from skyfolio.sim.parameter_store import ParameterStore
from skyfolio.sim.specs import VehicleSpec
from skyfolio.sim.traits import Traits

Refusal = tuple[tuple[str, int], ...]
"""Why an autopilot does not do something, as (text, MAV_SEVERITY) pairs to send; empty if it does."""


class Announcer(Protocol):
    """Sends to every ground station, and writes to the truth log."""

    def send_text(self, words: str, severity: int = dialect.MAV_SEVERITY_INFO) -> None:
        """Send a STATUSTEXT of a MAV_SEVERITY."""

    def announce(self, message_id: int) -> None:
        """Send a telemetry message now, beside its stream."""

    def emit(self, kind: str, detail: dict[str, Any], /) -> None:
        """Record what really happened (kinds: see `sim.truth.Event`)."""


class VehicleState(Protocol):
    """What the vehicle is doing, and where; metres east, north and up of the spawn point."""

    @property
    def armed(self) -> bool:
        """Whether the motors are armed."""

    @property
    def mode(self) -> Mode:
        """The flight mode."""

    @property
    def body(self) -> Body:
        """Where the vehicle truly is."""

    @property
    def seen(self) -> Body:
        """Where the vehicle believes that it is."""

    @property
    def home_m(self) -> Place:
        """Home, metres east and north of the spawn point."""

    @property
    def satellites(self) -> bool:
        """Whether the position is known."""

    @property
    def landed(self) -> bool:
        """Whether the autopilot believes that the vehicle stands on the ground."""


class Equipment(Protocol):
    """What the vehicle is made of, below the parts that decide."""

    spec: VehicleSpec
    traits: Traits
    frame: LocalFrame
    clock: OnboardClock
    parameters: ParameterStore
    battery: Battery
    gauge: Gauge
    dynamics: Dynamics
    runner: MissionRunner


class Commandable(Protocol):
    """Takes orders, from a ground station or from a failsafe."""

    def set_mode(self, mode: Mode, *, by_failsafe: bool = False) -> bool:
        """Change the mode; return whether it can be flown."""

    def disarm(self, *, force: bool = False, words: str | None = None) -> bool:
        """Disarm; return whether that was done."""
