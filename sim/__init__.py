"""A fleet of multirotors in software that speaks MAVLink 2 on UDP, as real PX4 and ArduCopter vehicles do.

Floors: it knows neither the planner, the bridge nor the service, and is built on pymavlink alone, so that it tests them
as an independent implementation. Real autopilots are the judge: where recordings (`tests/recordings`) and the simulator
differ, the simulator is wrong; the recordings are never edited. More in docs/simulator.md. From the bottom up:

    pure motion    `kinematics`, `airframe`, `weather`, `dynamics`; `geo` has places, `clock` and `onboard_clock` time
    protocols      `wire`, `signing`, `ftp`, `mission_protocol`, `parameter_store`, `command_table`, `telemetry_*`
    flavours       `traits` (data), `px4_*` and `ardupilot_*` (behaviour), `flavours` (one table for each autopilot)
    decisions      `navigator`, `mission_runner`, `failsafes`, `refusals`, `ground`; `hosts`: the vehicle as they see it
    one vehicle    `autopilot` puts the parts together, in virtual time; `station` adds a radio (`link`, `impairments`)
                   and a `base_station`; `radio_truth`: what users on the ground get from those of a fleet
    the fleet      `fleet` steps all vehicles on one clock; `ground_crew` gives those on their pads other `packs`;
                   `faults` are what can go wrong; `truth` logs what happened

A part takes a protocol of `hosts` or its own, never the whole autopilot. A difference between the autopilots belongs to
`traits` or a flavour's class, with the recording or source that shows it. Import what a client needs from here:

    async with Fleet(grid_of(3, 47.3977, 8.5456), clock=ScaledClock(10)) as fleet:
        fleet.inject(Kill(system_id=3), at_s=60.0)
        ...
"""

from skyfolio.sim.airframe import capacity_for_mah
from skyfolio.sim.base_station import BaseStation, Served
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
    Withhold,
    describe,
    fault_from,
    impairments_from,
)
from skyfolio.sim.field_texts import TURNAROUND_S, FieldKnobs, field_from, made_from
from skyfolio.sim.fleet import DEFAULT_ENDPOINT, Fleet, serve
from skyfolio.sim.ground_crew import GroundCrew
from skyfolio.sim.impairments import Impairments
from skyfolio.sim.kinematics import Limits
from skyfolio.sim.land import Hills
from skyfolio.sim.missions import Mission, MissionItem
from skyfolio.sim.modes import Mode
from skyfolio.sim.packs import Packs
from skyfolio.sim.radio_faults import RADIO_FAULTS, StationDeaf, StationJammed, StationLate, StationPower
from skyfolio.sim.radio_truth import MeanGain, RadioTruth, Received, TruthChannel, channel_from
from skyfolio.sim.slots import SlotGrid
from skyfolio.sim.specs import AUTOPILOTS, BATTERY_MAH, BOOTED_S_AGO, VehicleSpec, grid_of
from skyfolio.sim.station import Vehicle
from skyfolio.sim.tlog import TlogWriter
from skyfolio.sim.truth import Event, Sample, TruthLog, as_line
from skyfolio.sim.weather import Weather, WindFront

__all__ = [
    "AUTOPILOTS",
    "BATTERY_MAH",
    "BOOTED_S_AGO",
    "DEFAULT_ENDPOINT",
    "FAULTS",
    "RADIO_FAULTS",
    "TURNAROUND_S",
    "BaseStation",
    "Clock",
    "ClockJump",
    "CorruptUpload",
    "Event",
    "Fault",
    "FieldKnobs",
    "Fleet",
    "Freeze",
    "GpsLoss",
    "GroundCrew",
    "Hills",
    "Impair",
    "Impairments",
    "Kill",
    "Limits",
    "LowBattery",
    "MeanGain",
    "Mission",
    "MissionItem",
    "Mode",
    "ModeChange",
    "MotorFailure",
    "Mute",
    "Packs",
    "RadioTruth",
    "Reboot",
    "Received",
    "RejectMission",
    "Sample",
    "ScaledClock",
    "Served",
    "SlotGrid",
    "StationDeaf",
    "StationJammed",
    "StationLate",
    "StationPower",
    "TlogWriter",
    "TruthChannel",
    "TruthLog",
    "Vehicle",
    "VehicleSpec",
    "VirtualClock",
    "Weather",
    "WindFront",
    "Withhold",
    "as_line",
    "capacity_for_mah",
    "channel_from",
    "describe",
    "fault_from",
    "field_from",
    "grid_of",
    "impairments_from",
    "made_from",
    "parse_fault",
    "serve",
    "value_of",
]
