"""What can go wrong, as values: hand one to `Fleet.inject`, for now or for a moment of fleet time."""

from dataclasses import dataclass
from typing import Protocol

from sim.station import Vehicle


class Fault(Protocol):
    """Something that happens to one vehicle."""

    @property
    def system_id(self) -> int:
        """The vehicle it happens to."""
        ...

    def strike(self, vehicle: Vehicle) -> None:
        """Let it happen."""
        ...


@dataclass(frozen=True, slots=True)
class Kill:
    """The vehicle dies: motors stop, it falls, and no MAVLink ever comes from it again."""

    system_id: int

    def strike(self, vehicle: Vehicle) -> None:
        """Kill the vehicle."""
        vehicle.kill()


@dataclass(frozen=True, slots=True)
class Mute:
    """The radio dies: the vehicle flies on exactly as before, sends nothing and hears nothing."""

    system_id: int

    def strike(self, vehicle: Vehicle) -> None:
        """Mute the vehicle."""
        vehicle.mute()
