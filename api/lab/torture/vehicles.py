"""What is seen of the vehicles of one operation: the ground truth, which the service cannot know."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import inf
from typing import Any

from skyfolio import sim
from skyfolio.api.lab.torture.drill import Drill
from skyfolio.api.lab.torture.sightings import Gone, Stored, takes_over
from skyfolio.api.lab.virtual.ground import Ground
from skyfolio.planner.geometry import Point
from skyfolio.sim import Mode, airframe
from skyfolio.sim.geo import LocalFrame
from skyfolio.sim.station import Vehicle

LOW_M = 2.0
"""Metres above home; a vehicle that is higher is in the air."""
REFUSALS = frozenset({"reject_mission", "corrupt_upload"})
"""Faults of vehicles that fly well all the same."""
UNHARMED = frozenset({*sim.RADIO_FAULTS, "withhold"})
"""Faults with which a vehicle flies as before, and is heard."""
OURS = frozenset({Mode.GUIDED.name, Mode.MISSION.name})
"""Modes that we command."""
ON_ITS_WAY_S = 0.1
"""What is sent has arrived within this time, and that of the link."""


@dataclass
class Vehicles:
    """What was seen so far of the fleet, and which of its vehicles fly the operation. Times are virtual seconds."""

    drill: Drill
    ground: Ground
    uavs: Sequence[str] = ()
    """The UAVs that fly it; at first all."""
    harmed: dict[int, float] = field(default_factory=dict)
    """Since when each vehicle is not what it was: by a blow to it, virtual seconds."""
    ordered: dict[int, float] = field(default_factory=dict)
    """When the operator ordered each vehicle last."""
    harms: dict[int, set[str]] = field(default_factory=dict)
    """The faults that each vehicle has had."""
    foreign: dict[int, float] = field(default_factory=dict)
    """Since when each vehicle is flown by a human or a failsafe."""
    gone: dict[int, Gone] = field(default_factory=dict)
    """Vehicles that are dead, or that a human has taken."""
    refusing: set[int] = field(default_factory=set)
    """Vehicles that refuse uploads, or store them wrongly, and fly well all the same."""
    fell_unheard: set[int] = field(default_factory=set)
    """Vehicles that crashed while a fault kept them from being heard well, or while no service could know more.

    A fall of the last two metres of a landing looks like that landing.
    """
    excused_s: float = 0.0
    """Virtual seconds in which something kept the service from dealing with an incident."""
    _disturbed_until_s: dict[int, float] = field(default_factory=dict)
    _blind: set[int] = field(default_factory=set)
    _taken_over_s: dict[int, float] = field(default_factory=dict)
    _armed: set[int] = field(default_factory=set)
    _truth_seen: int = 0
    stored: dict[int, Stored] = field(default_factory=dict)
    """What each vehicle has stored last."""
    begun: list[tuple[float, int, Stored]] = field(default_factory=list)
    """Vehicles that have begun to fly the mission on board since the last look at that: when, and which."""
    fell_at_s: dict[int, float] = field(default_factory=dict)
    """When each vehicle was killed, or crashed."""
    _frame: LocalFrame | None = None

    def __post_init__(self) -> None:
        """Let it be all UAVs, unless some are named."""
        self.uavs = self.uavs or self.ground.scenario.uav_ids

    def vehicles(self) -> list[Vehicle]:
        """Return the vehicles that fly this operation."""
        return [self.ground.fleet.vehicles[self.system_of(uav)] for uav in self.uavs]

    def uav_of(self, system_id: int) -> str:
        """Return which UAV of the scenario a vehicle is."""
        return self.ground.scenario.uav_ids[system_id - 1]

    def system_of(self, uav: str) -> int:
        """Return which vehicle a UAV of the scenario is."""
        return self.ground.scenario.uav_ids.index(uav) + 1

    def is_aloft(self, vehicle: Vehicle) -> bool:
        """Return whether a vehicle is really in the air under its own power."""
        return vehicle.alive and vehicle.armed and vehicle.position[2] > LOW_M

    def follows_a_plan(self, vehicle: Vehicle) -> bool:
        """Return whether a vehicle is in a mode in which it flies a mission, or the setpoints that are streamed to it.

        A vehicle that is streamed to may fall back to its mission.
        """
        streamed = self.drill.guidance == "stream" and vehicle.mode is Mode.GUIDED
        return streamed or vehicle.mode is Mode.MISSION

    def is_heard_well(self, system_id: int) -> bool:
        """Return whether what a vehicle sends arrives, and it knows where it is."""
        return not self._is_disturbed(system_id) and self.ground.fleet.vehicles[system_id].transmitting

    def _is_disturbed(self, system_id: int) -> bool:
        return self.ground.now_s < self._disturbed_until_s.get(system_id, 0.0) or system_id in self._blind

    def follow_truth(self) -> None:
        """Take in what happened to vehicles since the last look."""
        events = self.ground.fleet.truth.events
        for event in events[self._truth_seen :]:
            system_id = event.system_id
            if event.kind == "fault" and event.detail.get("fault") in UNHARMED:
                continue
            if event.kind == "fault":
                self.harmed.setdefault(system_id, event.t_s)
                self._follow_fault(system_id, event.t_s, event.detail)
            elif event.kind in {"killed", "crashed"}:
                self._follow_gone(system_id, event.t_s)
                self._follow_fall(system_id, event.t_s, event.detail.get("impact_mps", inf))
            elif event.kind == "failsafe" and takes_over(event.detail):
                self.harmed.setdefault(system_id, event.t_s)
                self.foreign.setdefault(system_id, event.t_s)
            elif event.kind == "mission_accepted":
                self.stored[system_id] = Stored(**event.detail)
            elif event.kind == "mode":
                self._follow_mode(system_id, event.t_s, event.detail["mode"])
            elif event.kind in {"armed", "disarmed"}:
                self._follow_arming(system_id, armed=event.kind == "armed")
            elif event.kind in {"gps_lost", "gps_back"}:
                (self._blind.add if event.kind == "gps_lost" else self._blind.discard)(system_id)
        self._truth_seen = len(events)

    def _follow_arming(self, system_id: int, *, armed: bool) -> None:
        if armed:
            self._armed.add(system_id)
        else:
            self._armed.discard(system_id)
            self.foreign.pop(system_id, None)

    def _follow_mode(self, system_id: int, at_s: float, mode: str) -> None:
        if mode == Mode.MISSION.name and system_id in self.stored:
            self.begun.append((at_s, system_id, self.stored[system_id]))
        since_s = self._taken_over_s.pop(system_id, None) if mode in OURS else None
        if since_s is None or self._was_told(system_id, since_s, at_s):
            return
        self.foreign.pop(system_id, None)
        if system_id in self.gone and self.gone[system_id].at_s == since_s:
            del self.gone[system_id]

    def _was_told(self, system_id: int, since_s: float, until_s: float) -> bool:
        """Return whether a service could know of a mode before it sent the order that was followed at `until_s`.

        It knows a mode from HEARTBEATs alone, which come at 1 Hz. Who takes a vehicle over between two of them can be
        overruled by an order that leaves meanwhile: MAVLink has none that asks for the mode of before.
        """
        link_s = self.drill.latency_s
        heard = self.ground.heartbeats_s(system_id)
        return any(since_s + link_s < at_s < until_s - link_s - ON_ITS_WAY_S / 2 for at_s in heard)

    def _follow_fall(self, system_id: int, at_s: float, impact_mps: float) -> None:
        self.fell_at_s[system_id] = at_s
        if self._is_disturbed(system_id) or impact_mps**2 < 2.0 * airframe.GRAVITY_MPS2 * LOW_M:
            self.fell_unheard.add(system_id)

    def _follow_gone(self, system_id: int, at_s: float) -> None:
        self.gone.setdefault(system_id, Gone(at_s=at_s, excused_s=self.excused_s))

    def _follow_fault(self, system_id: int, at_s: float, fault: dict[str, Any]) -> None:
        self.harms.setdefault(system_id, set()).add(str(fault.get("fault")))
        if fault.get("fault") == "mode_change":
            if system_id not in self._armed:
                return  # it stands, and is launched by an order that comes after
            self.foreign[system_id] = at_s
            if fault.get("mode") not in OURS:
                self._taken_over_s[system_id] = at_s
            self._follow_gone(system_id, at_s)
        elif fault.get("fault") in REFUSALS:
            self.refusing.add(system_id)
        elif fault.get("fault") in {"impair", "mute", "freeze"}:
            until_s = inf if fault.get("for_s") is None else at_s + fault["for_s"]
            self._disturbed_until_s[system_id] = max(until_s, self._disturbed_until_s.get(system_id, 0.0))

    def end_of_mission_m(self, vehicle: Vehicle) -> Point | None:
        """Return the last place of the mission that a vehicle has on board, metres east and north; None if none."""
        places = ((item.x, item.y) for item in reversed(vehicle.mission.items) if item.x or item.y)
        return next((self.place_of(x / 1e7, y / 1e7) for x, y in places), None)

    def place_m(self, vehicle: Vehicle) -> tuple[float, float, float]:
        """Return where a vehicle truly is: metres east and north of the scenario's origin, and above its home."""
        lat_deg, lon_deg, up_m = vehicle.position
        return (*self.place_of(lat_deg, lon_deg), up_m)

    def place_of(self, lat_deg: float, lon_deg: float) -> Point:
        """Return metres east and north of the scenario's origin."""
        if self._frame is None:
            origin = self.ground.scenario.origin
            self._frame = LocalFrame(origin.lat_deg, origin.lon_deg)
        return self._frame.to_local(lat_deg, lon_deg)
