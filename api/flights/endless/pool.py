"""The vehicles of an operation that relieve each other, the stations that they keep manned, and who is where.

A vehicle is ready on its pad, outbound, on_station, inbound, in turnaround, or out_of_service. Its state follows from
what it reports and from the plan in force; what is stored is what neither tells, such as which station it is bound for.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

from skyfolio.api.flights.endless.relief_terms import ReliefTerms
from skyfolio.planner import Plan, Uav
from skyfolio.planner.geometry import Point

MOST_TRIES = 4
"""After so many reliefs that did not come about a vehicle flies home; after so many refusals it is out of service."""
MemberState = Literal["ready", "outbound", "on_station", "inbound", "turnaround", "out_of_service"]


@dataclass
class Member:
    """One vehicle. since_s: fleet seconds since slot 0 at which it came into its state, and `because` of what.

    tries: how often a relief by it was asked for since it left its pad. refusals: how often it did not leave its pad.
    rests_until_s: until then, fleet seconds since slot 0, it is asked for nothing again. called_home: whether it was
    sent home because its energy ended before it was relieved; it counts again when it has landed.
    """

    id: str
    state: MemberState
    station: str | None = None
    since_s: float = 0.0
    because: str = ""
    tries: int = 0
    refusals: int = 0
    rests_until_s: float = 0.0
    called_home: bool = False


@dataclass
class Station:
    """A place that is kept manned. dark_since_s: since when no vehicle mans it, fleet seconds since slot 0."""

    id: str
    place_m: Point
    manned_by: str | None
    dark_since_s: float | None = None


@dataclass(frozen=True, kw_only=True)
class Crossing:
    """A relief of one plan, in slots of the operation: who leaves and who takes over when."""

    plan_id: str
    station: str
    reliever: str
    relieved: str | None
    hand_over_at: int
    on_station_at: int
    home_at: int | None

    @property
    def ends_at(self) -> int:
        """Return the slot from which on no vehicle is under way."""
        return max(self.on_station_at, self.home_at or 0) + 1


@dataclass
class Pool:
    """The pool of one flight. pads_m: where each vehicle stands, metres east/north; uavs: as they are on their pads."""

    terms: ReliefTerms
    uavs: dict[str, Uav]
    members: dict[str, Member]
    stations: dict[str, Station]
    crossings: list[Crossing] = field(default_factory=list)
    reliefs: int = 0
    """How many vehicles have taken over a station."""

    @classmethod
    def of(cls, terms: ReliefTerms, plan: Plan) -> Pool:
        """Return the pool of an operation that begins with this plan: each of its UAVs mans a station."""
        uavs = {uav.id: uav for uav in (*plan.scenario.uavs, *terms.pool)}
        names = {uav: f"station-{number}" for number, uav in enumerate(plan.scenario.uav_ids, start=1)}
        members = {
            uav: Member(uav, "on_station" if uav in names else "ready", names.get(uav), because="the operation began")
            for uav in uavs
        }
        stations = {name: Station(name, plan.trajectories_m[uav][-1], uav) for uav, name in names.items()}
        return cls(terms, uavs, members, stations)

    # -- what it knows --------------------------------------------------------------------------------------------

    def in_state(self, *states: MemberState) -> list[Member]:
        """Return the members in these states."""
        return [member for member in self.members.values() if member.state in states]

    def can_go_on(self) -> bool:
        """Return whether any vehicle may yet fly for this operation."""
        return bool(self.in_state("ready", "outbound", "on_station", "turnaround", "inbound"))

    def under_way(self, flown: Collection[str], slot: int) -> list[str]:
        """Return the UAVs that fly a crossing of the plans that were flown and are not done with it by that slot."""
        return [
            uav
            for crossing in self.crossings
            if crossing.plan_id in flown and slot < crossing.ends_at
            for uav in (crossing.reliever, crossing.relieved)
            if uav is not None
        ]

    def relieved_by(self, reliever: str, plan: Plan, at_slot: int) -> tuple[str | None, Station]:
        """Return which UAV a vehicle relieves in a plan from `at_slot` on, or None, and at which station.

        Raises KeyError for a vehicle that is bound for no station.
        """
        station = self.stations[self.members[reliever].station or ""]
        there, scenario = station.manned_by, plan.scenario
        if there is None or there not in scenario.uav_ids:
            return None, station
        stays = plan.first_slot + scenario.last_slot(scenario.uav(there)) > at_slot
        return (there if stays else None), station

    # -- what happens ---------------------------------------------------------------------------------------------

    def order(self, uav: str, station: str, now_s: float, because: str) -> None:
        """Let a vehicle leave its pad for a station."""
        self.enter(self.members[uav], "outbound", because, now_s, station)

    def give_up(self, uav: str, state: MemberState, because: str, now_s: float) -> None:
        """Let a vehicle that was bound for a station be in another state."""
        self.enter(self.members[uav], state, because, now_s)

    def enter(self, member: Member, state: MemberState, because: str, now_s: float, station: str | None = None) -> None:
        """Let a member be in another state from now on; one that takes over is at the station that it was bound for."""
        if state == "on_station":
            station = member.station
            self.reliefs += 1
        member.tries = 0 if state == "outbound" else member.tries
        member.refusals = 0 if state == "on_station" else member.refusals
        member.state, member.station, member.because, member.since_s = state, station, because, round(now_s, 3)

    # -- for a restart --------------------------------------------------------------------------------------------

    def document(self) -> dict[str, Any]:
        """Return what a restart needs."""
        return {
            "terms": self.terms.model_dump(mode="json"),
            "members": [asdict(member) for member in self.members.values()],
            "stations": [asdict(station) for station in self.stations.values()],
            "crossings": [asdict(crossing) for crossing in self.crossings],
            "reliefs": self.reliefs,
        }

    @classmethod
    def restored(cls, document: dict[str, Any], plan: Plan) -> Pool:
        """Return the pool that `document` stored, of an operation that began with this plan."""
        pool = cls.of(ReliefTerms.model_validate(document["terms"]), plan)
        pool.members = {one["id"]: Member(**one) for one in document["members"]}
        stations = [{**one, "place_m": (one["place_m"][0], one["place_m"][1])} for one in document["stations"]]
        pool.stations = {one["id"]: Station(**one) for one in stations}
        pool.crossings, pool.reliefs = [Crossing(**one) for one in document["crossings"]], document["reliefs"]
        return pool
