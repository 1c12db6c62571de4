"""One drill: what is flown, what strikes, and when. As JSON it replays exactly."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from skyfolio import sim
from skyfolio.api.flights.guidance_options import GuidanceOptions, Mode
from skyfolio.api.flights.journal import Step
from skyfolio.api.flights.operation_views import Policy, State
from skyfolio.api.lab.virtual.ground import Ground
from skyfolio.mavlink_bridge import OnEnd
from skyfolio.mavlink_bridge.autopilots import DEFAULT_AUTOPILOT, Autopilot
from skyfolio.mavlink_bridge.guidance import FallBack
from skyfolio.planner import EXAMPLES, Scenario
from skyfolio.planner.geometry import Point

HOLDS = ("COM_OBL_RC_ACT", 5)
"""What the preflight audit demands of a PX4 that follows setpoints: hold when they end."""


class _Document(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


VehicleNews = Literal[
    "armed", "takeoff", "item_reached", "mission_accepted", "failsafe", "mode", "landed", "disarmed", "booted"
]
"""What happens to a vehicle: kinds of `sim.truth.Event`."""


class Moment(_Document):
    """When a blow strikes: at a journal step, at a state, at a vehicle's news, or `after_s` the operation was created.

    step: the `nth` time it is written; stored: once it is stored, or else just before. state: the `nth` time the
    operation enters it. vehicle: the `nth` time it happens to any vehicle. after_s: fleet seconds after that.
    """

    step: Step | None = None
    stored: bool = True
    state: State | None = None
    vehicle: VehicleNews | None = None
    nth: int = Field(default=1, ge=1)
    after_s: float = Field(default=0.0, ge=0.0)

    @model_validator(mode="after")
    def _one_of_them(self) -> Moment:
        if sum(one is not None for one in (self.step, self.state, self.vehicle)) > 1:
            raise ValueError("step and state and vehicle: a moment is at one of them")
        return self

    @property
    def is_by_time(self) -> bool:
        """Return whether it is at a time, and at nothing that happens."""
        return self.step is None and self.state is None and self.vehicle is None

    @property
    def where(self) -> str:
        """Return what it is at."""
        if self.step is not None:
            return f"{'after' if self.stored else 'before'} {self.step.value}"
        if self.vehicle is not None:
            return f"vehicle {self.vehicle}"
        return "start" if self.state is None else self.state.value

    def __str__(self) -> str:
        return f"{self.where}{f' #{self.nth}' if self.nth > 1 else ''}{f' +{self.after_s:g} s' if self.after_s else ''}"


class Blow(_Document):
    """Something that strikes: a name of `blows.BLOWS` with its options."""

    when: Moment
    kind: str
    options: dict[str, Any] = {}

    def __str__(self) -> str:
        options = ", ".join(f"{name}={value}" for name, value in self.options.items())
        return f"{self.when}: {self.kind}({options})"


FIRST_START_M, STARTS_APART_M = (240.0, 150.0), 10.0
"""Where the first of UAVs that start side by side does, metres east and north, and how far the next is from it."""


WAY_HOME_STARTS_M = ((250.0, 180.0), (250.0, 60.0), (60.0, 420.0))
"""Where UAVs start if the second one is to fly along the way home of the first, metres east and north."""
RALLY_START_M = (330.0, 240.0)
"""Where the first of them does if it may land at a rally point that is where it would start otherwise."""
WAY_HOME_USERS_M = ((250.0, 280.0), (246.0, 274.0), (250.0, 50.0), (60.0, 440.0), (60.0, 424.0))
"""Where their users are: those of the first farther from the second than that can fly in the slots that are left."""


class Drill(_Document):
    """One drill.

    guidance, fall_back, at_end: as of `GuidanceOptions`. loss: share of datagrams lost both ways.
    latency_s: of datagrams, each way. stations: whether base stations serve and measure; bias_db: how much better
    their links are than planned. gust_mps, gps_m: as of `sim.Weather`. solve_s: of a replan.
    """

    seed: int
    example: Literal["paper", "minimal"] = "paper"
    slots: int = Field(default=12, ge=4, le=60)
    altitude_m: float = Field(default=10.0, gt=0)
    autopilots: tuple[Autopilot, ...] = (DEFAULT_AUTOPILOT,)
    policy: Policy = "auto"
    guidance: Mode = "mission"
    fall_back: FallBack = FallBack.MISSION
    at_end: OnEnd = OnEnd.LAND
    loss: float = Field(default=0.0, ge=0.0, le=1.0)
    latency_s: float = Field(default=0.0, ge=0.0, le=1.0)
    gust_mps: float = Field(default=0.0, ge=0.0)
    gps_m: float = Field(default=0.0, ge=0.0)
    solve_s: float = Field(default=0.05, ge=0.0)
    plan_ahead: bool = True
    stations: bool = False
    bias_db: float = Field(default=0.0, ge=-60.0, le=60.0)
    beside: bool = False
    """Whether the last UAV flies an operation of its own at the same time."""
    side_by_side: bool = False
    """Whether all UAVs start side by side, so that the way home of one crosses where the others fly."""
    along_a_way_home: bool = False
    """Whether users are where the second UAV flies along the way home of the first, and at no end of it."""
    rally: bool = False
    """Whether it is its way to a rally point instead, and it starts elsewhere."""
    blows: tuple[Blow, ...] = ()

    def scenario(self) -> Scenario:
        """Return what is flown."""
        scenario = EXAMPLES[self.example]().with_changes(slots=self.slots, altitude_m=self.altitude_m)
        if self.along_a_way_home:
            return _along_a_way_home(scenario, rally=self.rally)
        if not self.side_by_side:
            return scenario
        east_m, north_m = FIRST_START_M
        starts_m = [(east_m + STARTS_APART_M * place, north_m) for place in range(len(scenario.uavs))]
        return _starting_at(scenario, starts_m)

    def flown(self) -> tuple[Scenario, Scenario | None]:
        """Return what the operation flies, and what the one beside it flies, if there is one."""
        scenario = self.scenario()
        if not self.beside:
            return scenario, None
        *most, last = scenario.uavs
        return scenario.with_changes(uavs=most), scenario.with_changes(uavs=[last])

    def options(self) -> GuidanceOptions:
        """Return how the flight is guided."""
        return GuidanceOptions(mode=self.guidance, fall_back=self.fall_back, at_end=self.at_end)

    def ground(self) -> Ground:
        """Return the ground for it, on the running virtual loop."""
        scenario = self.scenario()
        made = Ground(
            scenario,
            seed=self.seed,
            specs=Ground.specs_of(scenario, self.autopilots),
            weather=sim.Weather(gust_mps=self.gust_mps, gps_m=self.gps_m),
            solve_s=lambda _job: self.solve_s,
            plan_ahead=self.plan_ahead,
        )
        if self.guidance == "stream":
            for vehicle in made.fleet.vehicles.values():
                if HOLDS[0] in vehicle.autopilot.parameters:
                    vehicle.autopilot.parameters[HOLDS[0]] = HOLDS[1]
        if self.loss or self.latency_s:
            link = sim.Impairments(loss=self.loss, latency_s=self.latency_s)
            made.fleet.impair(up=link, down=link)
        return made


def _starting_at(scenario: Scenario, starts_m: Sequence[Point]) -> Scenario:
    uavs = zip(scenario.uavs, starts_m, strict=True)
    return scenario.with_changes(uavs=[uav.model_copy(update={"start_m": start_m}) for uav, start_m in uavs])


def _along_a_way_home(scenario: Scenario, *, rally: bool) -> Scenario:
    """Return a scenario in which a UAV that is left serves far users, as all users' rates count together."""
    users = zip(scenario.users, WAY_HOME_USERS_M, strict=False)
    first_m, *others_m = WAY_HOME_STARTS_M
    return _starting_at(scenario, [RALLY_START_M if rally else first_m, *others_m]).with_changes(
        rally_points=[{"position_m": first_m}] if rally else [],
        users=[user.model_copy(update={"position_m": at_m}) for user, at_m in users],
        utility=scenario.utility.model_copy(update={"kind": "pooled"}),
    )
