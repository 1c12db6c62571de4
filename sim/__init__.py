"""A fleet of multirotors in software that speaks MAVLink 2 on UDP, as real PX4 and ArduCopter vehicles do.

It knows nothing of the planner, the bridge or the service, and is built on pymavlink alone, so that it tests them as
a stranger would. `flavours` is where the two autopilots differ. `vehicle` is how an airframe moves, `navigator` and
`mission_runner` decide where to, `autopilot` chooses the mode and answers messages; all of these are pure and run in
virtual time. `station` adds a radio (`link`, `impairments`), `fleet` steps all vehicles on one injected clock,
`faults` are what can go wrong, and `truth` is what really happened. More in docs/simulator.md.

    async with Fleet(grid_of(3, 47.3977, 8.5456), clock=ScaledClock(10)) as fleet:
        fleet.inject(Kill(system_id=3), at_s=60.0)
        ...
"""

from skyfolio.sim.clock import Clock, ScaledClock, VirtualClock
from skyfolio.sim.fault_schedule import parse_fault, value_of
from skyfolio.sim.faults import (
    FAULTS,
    ClockJump,
    CorruptUpload,
    Fault,
    Freeze,
    GpsLoss,
    Impair,
    Kill,
    LowBattery,
    ModeChange,
    MotorFailure,
    Mute,
    Reboot,
    RejectMission,
    describe,
    fault_from,
    impairments_from,
)
from skyfolio.sim.fleet import DEFAULT_ENDPOINT, Fleet, serve
from skyfolio.sim.impairments import Impairments
from skyfolio.sim.kinematics import Limits
from skyfolio.sim.missions import Mission, MissionItem
from skyfolio.sim.modes import Mode
from skyfolio.sim.slots import SlotGrid
from skyfolio.sim.specs import AUTOPILOTS, BOOTED_S_AGO, VehicleSpec, grid_of
from skyfolio.sim.station import Vehicle
from skyfolio.sim.tlog import TlogWriter
from skyfolio.sim.truth import Event, Sample, TruthLog, as_line
from skyfolio.sim.weather import Weather

__all__ = [
    "AUTOPILOTS",
    "BOOTED_S_AGO",
    "DEFAULT_ENDPOINT",
    "FAULTS",
    "Clock",
    "ClockJump",
    "CorruptUpload",
    "Event",
    "Fault",
    "Fleet",
    "Freeze",
    "GpsLoss",
    "Impair",
    "Impairments",
    "Kill",
    "Limits",
    "LowBattery",
    "Mission",
    "MissionItem",
    "Mode",
    "ModeChange",
    "MotorFailure",
    "Mute",
    "Reboot",
    "RejectMission",
    "Sample",
    "ScaledClock",
    "SlotGrid",
    "TlogWriter",
    "TruthLog",
    "Vehicle",
    "VehicleSpec",
    "VirtualClock",
    "Weather",
    "as_line",
    "describe",
    "fault_from",
    "grid_of",
    "impairments_from",
    "parse_fault",
    "serve",
    "value_of",
]
