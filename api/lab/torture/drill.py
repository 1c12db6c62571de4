"""One drill: what is flown, what strikes, and when. As JSON it replays exactly."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from skyfolio import sim
from skyfolio.api.flights.journal import Step
from skyfolio.api.flights.operation_views import Policy, State
from skyfolio.api.lab.virtual.ground import Ground
from skyfolio.mavlink_bridge.autopilots import DEFAULT_AUTOPILOT, Autopilot
from skyfolio.planner import EXAMPLES, Scenario


class _Document(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class Moment(_Document):
    """When a blow strikes: at a journal step, at a state of the operation, or `after_s` the operation was created.

    step: the `nth` time it is written; stored: once it is stored, or else just before. state: the `nth` time it is
    entered. after_s: fleet seconds after that.
    """

    step: Step | None = None
    stored: bool = True
    state: State | None = None
    nth: int = Field(default=1, ge=1)
    after_s: float = Field(default=0.0, ge=0.0)

    @model_validator(mode="after")
    def _one_of_them(self) -> Moment:
        if self.step is not None and self.state is not None:
            raise ValueError("step and state: a moment is at one of them")
        return self

    def __str__(self) -> str:
        if self.step is not None:
            where = f"{'after' if self.stored else 'before'} {self.step.value}"
        else:
            where = "start" if self.state is None else self.state.value
        return f"{where}{f' #{self.nth}' if self.nth > 1 else ''}{f' +{self.after_s:g} s' if self.after_s else ''}"


class Blow(_Document):
    """Something that strikes: a name of `blows.BLOWS` with its options."""

    when: Moment
    kind: str
    options: dict[str, Any] = {}

    def __str__(self) -> str:
        options = ", ".join(f"{name}={value}" for name, value in self.options.items())
        return f"{self.when}: {self.kind}({options})"


class Drill(_Document):
    """One drill. loss: share of datagrams lost both ways. gust_mps, gps_m: as `sim.Weather`. solve_s: of a replan."""

    seed: int
    example: Literal["paper", "minimal"] = "paper"
    slots: int = Field(default=12, ge=4, le=60)
    altitude_m: float = Field(default=10.0, gt=0)
    autopilots: tuple[Autopilot, ...] = (DEFAULT_AUTOPILOT,)
    policy: Policy = "auto"
    loss: float = Field(default=0.0, ge=0.0, le=1.0)
    gust_mps: float = Field(default=0.0, ge=0.0)
    gps_m: float = Field(default=0.0, ge=0.0)
    solve_s: float = Field(default=0.05, ge=0.0)
    plan_ahead: bool = True
    blows: tuple[Blow, ...] = ()

    def scenario(self) -> Scenario:
        """Return what is flown."""
        return EXAMPLES[self.example]().with_changes(slots=self.slots, altitude_m=self.altitude_m)

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
        if self.loss:
            made.fleet.impair(up=sim.Impairments(loss=self.loss), down=sim.Impairments(loss=self.loss))
        return made
