"""What can go wrong, as values: pass one to `Fleet.inject`, for now, for a moment of fleet time, or for a slot.

Each fault is a frozen dataclass; its fields are the knobs. `FAULTS` names them for JSON and the command line:
`fault_from({"kind": "mute", "system_id": 3, "for_s": 20})` and `parse_fault("mute:3@60,for_s=20")`. `for_s` None means
for good; durations are fleet seconds. Every knob is checked when a fault is created: ValueError names field, value and
rule.
"""

from dataclasses import MISSING, asdict, dataclass, fields
from typing import Any, Protocol

from skyfolio.sim.impairments import Impairments
from skyfolio.sim.knobs import (
    LONGEST_S,
    MOST_UPLOADS,
    check_duration,
    check_lasting,
    check_number,
    check_vehicle,
    check_whole,
)
from skyfolio.sim.modes import Mode
from skyfolio.sim.radio_faults import RADIO_FAULTS
from skyfolio.sim.station import REBOOT_S, Vehicle
from skyfolio.sim.wire import MESSAGE_NAMES


class Fault(Protocol):
    """Something that happens to one vehicle."""

    @property
    def system_id(self) -> int:
        """The MAVLink system id of the vehicle."""
        ...

    def strike(self, vehicle: Vehicle) -> None:
        """Let the fault happen to `vehicle`, which has that system id."""
        ...


@dataclass(frozen=True, slots=True)
class Kill:
    """The vehicle dies: the motors stop, it falls, and it never sends MAVLink again."""

    system_id: int

    def __post_init__(self) -> None:
        check_vehicle(self.system_id)

    def strike(self, vehicle: Vehicle) -> None:
        """Kill the vehicle."""
        vehicle.kill()


@dataclass(frozen=True, slots=True)
class Mute:
    """The radio fails: the vehicle flies on exactly as before, but neither sends nor receives (a ghost)."""

    system_id: int
    for_s: float | None = None

    def __post_init__(self) -> None:
        check_vehicle(self.system_id)
        check_lasting(self.for_s)

    def strike(self, vehicle: Vehicle) -> None:
        """Mute the vehicle."""
        vehicle.mute(self.for_s)


@dataclass(frozen=True, slots=True)
class Reboot:
    """The autopilot restarts: it sends nothing for `for_s`, then its clock starts at 0. In the air the motors stop."""

    system_id: int
    for_s: float = REBOOT_S

    def __post_init__(self) -> None:
        check_vehicle(self.system_id)
        check_duration("for_s", self.for_s)

    def strike(self, vehicle: Vehicle) -> None:
        """Reboot the autopilot."""
        vehicle.reboot(self.for_s)


@dataclass(frozen=True, slots=True)
class Freeze:
    """The autopilot hangs: it neither sends nor receives, and the motors keep turning as they did."""

    system_id: int
    for_s: float | None = None

    def __post_init__(self) -> None:
        check_vehicle(self.system_id)
        check_lasting(self.for_s)

    def strike(self, vehicle: Vehicle) -> None:
        """Freeze the autopilot."""
        vehicle.freeze(self.for_s)


@dataclass(frozen=True, slots=True)
class LowBattery:
    """The battery has only `share` (0-1) left; what follows is up to the failsafe parameters."""

    system_id: int
    share: float = 0.1

    def __post_init__(self) -> None:
        check_vehicle(self.system_id)
        check_number("share", self.share, 0.0, 1.0)

    def strike(self, vehicle: Vehicle) -> None:
        """Drain the battery."""
        vehicle.autopilot.component_failures.set_battery(self.share)


@dataclass(frozen=True, slots=True)
class GpsLoss:
    """No satellites: the position estimate drifts away, and the failsafe lands it."""

    system_id: int
    for_s: float | None = None

    def __post_init__(self) -> None:
        check_vehicle(self.system_id)
        check_lasting(self.for_s)

    def strike(self, vehicle: Vehicle) -> None:
        """Lose the satellites."""
        vehicle.autopilot.component_failures.lose_satellites()
        vehicle.after(self.for_s, vehicle.autopilot.component_failures.regain_satellites)


@dataclass(frozen=True, slots=True)
class MotorFailure:
    """A motor stops; the quadrotor tumbles and falls, and sends telemetry as long as it can."""

    system_id: int

    def __post_init__(self) -> None:
        check_vehicle(self.system_id)

    def strike(self, vehicle: Vehicle) -> None:
        """Stop a motor."""
        vehicle.autopilot.component_failures.fail_motor()


@dataclass(frozen=True, slots=True)
class ModeChange:
    """A pilot takes over by remote control: the vehicle changes to `mode` (a name of `sim.Mode`)."""

    system_id: int
    mode: str = "POSITION"

    def __post_init__(self) -> None:
        check_vehicle(self.system_id)
        if self.mode not in Mode.__members__:
            raise ValueError(f"mode must be one of {', '.join(Mode.__members__)}, got {self.mode!r}")

    def strike(self, vehicle: Vehicle) -> None:
        """Change the mode."""
        vehicle.autopilot.set_mode(Mode[self.mode])


@dataclass(frozen=True, slots=True)
class RejectMission:
    """The next `uploads` are refused with MAV_MISSION_ERROR after their last item."""

    system_id: int
    uploads: int = 1

    def __post_init__(self) -> None:
        check_vehicle(self.system_id)
        check_whole("uploads", self.uploads, 1, MOST_UPLOADS)

    def strike(self, vehicle: Vehicle) -> None:
        """Refuse the next uploads."""
        vehicle.autopilot.missions.refusals += self.uploads


@dataclass(frozen=True, slots=True)
class CorruptUpload:
    """The next `uploads` are acknowledged, but their last item is stored 22 m off: only a read-back shows it."""

    system_id: int
    uploads: int = 1

    def __post_init__(self) -> None:
        check_vehicle(self.system_id)
        check_whole("uploads", self.uploads, 1, MOST_UPLOADS)

    def strike(self, vehicle: Vehicle) -> None:
        """Corrupt the next uploads."""
        vehicle.autopilot.missions.corruptions += self.uploads


@dataclass(frozen=True, slots=True)
class ClockJump:
    """The autopilot's clock jumps by `seconds`, forwards or backwards."""

    system_id: int
    seconds: float = -30.0

    def __post_init__(self) -> None:
        check_vehicle(self.system_id)
        check_number("seconds", self.seconds, -LONGEST_S, LONGEST_S)

    def strike(self, vehicle: Vehicle) -> None:
        """Let the clock jump."""
        vehicle.autopilot.component_failures.jump_clock(self.seconds)


@dataclass(frozen=True, slots=True)
class Impair:
    """The link gets worse: `up` is to the vehicle, `down` from it; None leaves a direction as it is.

    After `for_s` seconds the link is what it was before.
    """

    system_id: int
    up: Impairments | None = None
    down: Impairments | None = None
    for_s: float | None = None

    def __post_init__(self) -> None:
        check_vehicle(self.system_id)
        check_lasting(self.for_s)
        for direction in ("up", "down"):
            value = getattr(self, direction)
            if value is not None and not isinstance(value, Impairments):
                raise ValueError(f"{direction} must be the impairments of a link, got {value!r}")

    def strike(self, vehicle: Vehicle) -> None:
        """Impair the link."""
        before = (vehicle.radio.up.impairments, vehicle.radio.down.impairments)
        vehicle.radio.impair(up=self.up, down=self.down)
        vehicle.after(self.for_s, lambda: vehicle.radio.impair(up=before[0], down=before[1]))


@dataclass(frozen=True, slots=True)
class Withhold:
    """The radio's scheduler does not get round to one kind of message: none of it is sent, streamed or requested.

    message: its name. The vehicle flies, and is heard, as before.
    """

    system_id: int
    message: str = "MISSION_CURRENT"
    for_s: float | None = None

    def __post_init__(self) -> None:
        check_vehicle(self.system_id)
        check_lasting(self.for_s)
        if not isinstance(self.message, str) or self.message not in MESSAGE_NAMES:
            raise ValueError(f"message must be the name of a MAVLink message, got {self.message!r}")

    def strike(self, vehicle: Vehicle) -> None:
        """Withhold the message."""
        vehicle.withheld.add(self.message)
        vehicle.after(self.for_s, lambda: vehicle.withheld.discard(self.message))


FAULTS: dict[str, type[Any]] = {
    "kill": Kill,
    "mute": Mute,
    "reboot": Reboot,
    "freeze": Freeze,
    "low_battery": LowBattery,
    "gps_loss": GpsLoss,
    "motor_failure": MotorFailure,
    "mode_change": ModeChange,
    "reject_mission": RejectMission,
    "corrupt_upload": CorruptUpload,
    "clock_jump": ClockJump,
    "impair": Impair,
    "withhold": Withhold,
    **RADIO_FAULTS,
}
_NAMES = {fault: name for name, fault in FAULTS.items()}


def describe(fault: Fault) -> dict[str, Any]:
    """Return a fault as plain data, `kind` first; knobs that are None are left out."""
    values = {name: value for name, value in asdict(fault).items() if value is not None}  # type: ignore[call-overload]
    for direction in ("up", "down"):
        if direction in values:
            chosen = {name: v for name, v in values[direction].items() if v != getattr(Impairments(), name)}
            values[direction] = chosen
    return {"kind": _NAMES.get(type(fault), type(fault).__name__), **values}


def fault_from(data: dict[str, Any]) -> Fault:
    """Return the fault that plain data describes; ValueError names the field that is wrong."""
    values = dict(data)
    kind = values.pop("kind", None)
    if kind not in FAULTS:
        raise ValueError(f"kind must be one of {', '.join(FAULTS)}, got {kind!r}")
    knobs = {field.name: field for field in fields(FAULTS[kind])}
    for name in values:
        if name not in knobs:
            raise ValueError(f"{name}: {kind} has no such field, it has {', '.join(knobs)}")
    missing = [name for name, field in knobs.items() if field.default is MISSING and name not in values]
    if missing:
        raise ValueError(f"{missing[0]}: {kind} needs it")
    for direction in ("up", "down"):
        if isinstance(values.get(direction), dict):
            values[direction] = impairments_from(values[direction])
    fault: Fault = FAULTS[kind](**values)
    return fault


def impairments_from(data: dict[str, Any]) -> Impairments:
    """Return the impairments that plain data describes; ValueError names the field that is wrong."""
    knobs = {field.name for field in fields(Impairments)}
    for name in data:
        if name not in knobs:
            raise ValueError(f"{name}: a link has no such impairment, it has {', '.join(sorted(knobs))}")
    return Impairments(**data)
