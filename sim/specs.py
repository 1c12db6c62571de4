"""Which vehicles stand on the field: the description of one vehicle, and a grid of them."""

import math
from dataclasses import dataclass

from skyfolio.sim.geo import LocalFrame
from skyfolio.sim.knobs import LONGEST_S, check_number

BATTERY_MAH = 5000.0
"""What a new pack of the airframe holds."""
LEAST_MAH, MOST_MAH = 100.0, 100_000.0
AUTOPILOTS = ("px4", "ardupilot")
BOOTED_S_AGO = 60.0
"""Seconds for which a vehicle has been on by default: long enough to be ready."""


@dataclass(frozen=True, slots=True)
class VehicleSpec:
    """One vehicle.

    system_id: its MAVLink system id (1-254). home_lat_deg, home_lon_deg, home_alt_m: where it stands (WGS 84 degrees,
    metres above sea level). autopilot: "px4" or "ardupilot" (ArduCopter). booted_s_ago: how many seconds the autopilot
    has been on; with 0 it is switched on with the fleet, and an ArduCopter then takes 40 s until it can be armed.
    battery_mah: what its battery holds when it is new, which its autopilot has as a parameter. parameters: names and
    values that are set on board from the beginning; those that the autopilot does not have are left out.
    ValueError names the field that is out of range.
    """

    system_id: int
    home_lat_deg: float
    home_lon_deg: float
    home_alt_m: float = 488.0
    autopilot: str = "px4"
    booted_s_ago: float = BOOTED_S_AGO
    battery_mah: float = BATTERY_MAH
    parameters: tuple[tuple[str, float], ...] = ()

    def __post_init__(self) -> None:
        if not 1 <= self.system_id <= 254:
            raise ValueError(f"system_id must be between 1 and 254, got {self.system_id}")
        if not -90.0 < self.home_lat_deg < 90.0:
            raise ValueError(f"home_lat_deg must be between -90 and 90, got {self.home_lat_deg}")
        if not -180.0 <= self.home_lon_deg <= 180.0:
            raise ValueError(f"home_lon_deg must be between -180 and 180, got {self.home_lon_deg}")
        if not -500.0 <= self.home_alt_m <= 9000.0:
            raise ValueError(f"home_alt_m must be between -500 and 9000, got {self.home_alt_m}")
        if self.autopilot not in AUTOPILOTS:
            raise ValueError(f"autopilot must be one of {', '.join(AUTOPILOTS)}, got {self.autopilot!r}")
        check_number("booted_s_ago", self.booted_s_ago, 0.0, LONGEST_S)
        check_number("battery_mah", self.battery_mah, LEAST_MAH, MOST_MAH)


def grid_of(
    count: int,
    lat_deg: float,
    lon_deg: float,
    spacing_m: float = 10.0,
    autopilot: str = "px4",
    booted_s_ago: float = BOOTED_S_AGO,
) -> list[VehicleSpec]:
    """Return `count` vehicles with system ids 1.. in a square grid centred on a place, row by row from the south-west.

    ValueError unless 1 <= count <= 254 and spacing_m is positive.
    """
    if not 1 <= count <= 254:
        raise ValueError(f"count must be between 1 and 254, got {count}")
    if not 0.0 < spacing_m < math.inf:
        raise ValueError(f"spacing_m must be a positive number, got {spacing_m}")
    frame = LocalFrame(lat_deg, lon_deg)
    columns = math.ceil(math.sqrt(count))
    rows = math.ceil(count / columns)
    specs = []
    for index in range(count):
        row, column = divmod(index, columns)
        east_m, north_m = (column - (columns - 1) / 2.0) * spacing_m, (row - (rows - 1) / 2.0) * spacing_m
        place = frame.to_geodetic(east_m, north_m)
        specs.append(VehicleSpec(index + 1, *place, autopilot=autopilot, booted_s_ago=booted_s_ago))
    return specs
