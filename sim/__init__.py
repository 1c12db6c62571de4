"""A fleet of multirotors in software that speaks MAVLink 2 on UDP, as a real autopilot does.

It knows nothing of the planner, the bridge or the service, and is built on pymavlink alone, so that it tests them as
a stranger would. `vehicle` is how an airframe moves, `mission_runner` flies a mission, `autopilot` chooses the mode
and answers messages (`mission_protocol`, `parameters`, `commands`, `telemetry`); all of these are pure and run in
virtual time. `station` adds a radio (`link`), `fleet` steps all vehicles on one injected clock, `faults` are what can
go wrong, and `truth` is what really happened.

    async with Fleet(grid_of(3, 47.3977, 8.5456), clock=ScaledClock(10)) as fleet:
        fleet.inject(Kill(system_id=3), at_s=60.0)
        ...
"""

from sim.clock import Clock, ScaledClock, VirtualClock
from sim.faults import Fault, Kill, Mute
from sim.fleet import DEFAULT_ENDPOINT, Fleet, serve
from sim.lineup import VehicleSpec, grid_of
from sim.missions import Mission, MissionItem
from sim.modes import Mode
from sim.station import Vehicle
from sim.truth import Event, Sample, TruthLog
from sim.vehicle import Limits

__all__ = [
    "DEFAULT_ENDPOINT",
    "Clock",
    "Event",
    "Fault",
    "Fleet",
    "Kill",
    "Limits",
    "Mission",
    "MissionItem",
    "Mode",
    "Mute",
    "Sample",
    "ScaledClock",
    "TruthLog",
    "Vehicle",
    "VehicleSpec",
    "VirtualClock",
    "grid_of",
    "serve",
]
