"""What can go wrong with the base station that a vehicle carries. Like other faults, `for_s` None means for good."""

from dataclasses import dataclass
from typing import Any

from skyfolio.sim.knobs import check_lasting, check_number, check_vehicle
from skyfolio.sim.station import Vehicle

MOST_DB = 60.0


@dataclass(frozen=True, slots=True)
class StationDeaf:
    """The base station receives no orders: it serves what it has acknowledged until that ends, and then no user."""

    system_id: int
    for_s: float | None = None

    def __post_init__(self) -> None:
        check_vehicle(self.system_id)
        check_lasting(self.for_s)

    def strike(self, vehicle: Vehicle) -> None:
        """Let the base station receive nothing."""
        vehicle.base_station.deaf = True
        vehicle.after(self.for_s, lambda: setattr(vehicle.base_station, "deaf", False))


@dataclass(frozen=True, slots=True)
class StationLate:
    """The base station takes `seconds` to get ready for an order, and acknowledges it only then."""

    system_id: int
    seconds: float = 2.0
    for_s: float | None = None

    def __post_init__(self) -> None:
        check_vehicle(self.system_id)
        check_number("seconds", self.seconds, 0.0, 3600.0)
        check_lasting(self.for_s)

    def strike(self, vehicle: Vehicle) -> None:
        """Let the base station be late."""
        vehicle.base_station.late_s = self.seconds
        vehicle.after(self.for_s, lambda: setattr(vehicle.base_station, "late_s", 0.0))


@dataclass(frozen=True, slots=True)
class StationPower:
    """The base station sends `db` more than it was built for, or less."""

    system_id: int
    db: float = -6.0
    for_s: float | None = None

    def __post_init__(self) -> None:
        check_vehicle(self.system_id)
        check_number("db", self.db, -MOST_DB, MOST_DB)
        check_lasting(self.for_s)

    def strike(self, vehicle: Vehicle) -> None:
        """Let the base station send with the wrong power."""
        vehicle.base_station.power_db = self.db
        vehicle.after(self.for_s, lambda: setattr(vehicle.base_station, "power_db", 0.0))


@dataclass(frozen=True, slots=True)
class StationJammed:
    """The users of the base station receive `db` more noise."""

    system_id: int
    db: float = 20.0
    for_s: float | None = None

    def __post_init__(self) -> None:
        check_vehicle(self.system_id)
        check_number("db", self.db, 0.0, MOST_DB)
        check_lasting(self.for_s)

    def strike(self, vehicle: Vehicle) -> None:
        """Jam the users of the base station."""
        vehicle.base_station.jam_db = self.db
        vehicle.after(self.for_s, lambda: setattr(vehicle.base_station, "jam_db", 0.0))


RADIO_FAULTS: dict[str, type[Any]] = {
    "station_deaf": StationDeaf,
    "station_late": StationLate,
    "station_power": StationPower,
    "station_jammed": StationJammed,
}
