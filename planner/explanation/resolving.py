"""Plans of changed scenarios within a budget, from the plan's own paths and held to its pins."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from skyfolio.planner.arrays import Array
from skyfolio.planner.carrying import carried
from skyfolio.planner.explanation.ledger import Ledger
from skyfolio.planner.pinning import PinError
from skyfolio.planner.pins import Pins
from skyfolio.planner.plans import Plan
from skyfolio.planner.scenario import Scenario
from skyfolio.planner.solve import converged, plan
from skyfolio.planner.stopping import AnyOf, StopToken
from skyfolio.planner.unreachable import UnreachableEndError


@dataclass(frozen=True, kw_only=True)
class Budget:
    """How much an explanation may solve.

    starts: of each resolve, the plan's own paths first. most_resolves: in all. most_cells: UAVs x users x slots up to
    which anything is resolved; larger fleets get bounds and derivatives only.
    """

    starts: int = 3
    most_resolves: int = 32
    most_cells: int = 100_000

    def __post_init__(self) -> None:
        if self.starts < 1:
            raise ValueError(f"starts: {self.starts} must be at least 1")
        if self.most_resolves < 0 or self.most_cells < 0:
            raise ValueError("most_resolves and most_cells must not be negative")


@dataclass
class Resolver:
    """Solves changed scenarios as long as the budget and `stop` allow; `count` says how many it has solved."""

    ledger: Ledger
    budget: Budget
    stop: Callable[[], bool]
    count: int = 0
    interrupted: bool = False
    _same: Plan | None = field(default=None, repr=False)

    @property
    def small_enough(self) -> bool:
        """Return whether anything is resolved at all."""
        return self.ledger.problem.snr_gain.size <= self.budget.most_cells and self.budget.most_resolves > 0

    @property
    def may_go_on(self) -> bool:
        """Return whether the budget allows one more resolve."""
        return self.small_enough and self.count < self.budget.most_resolves

    def nothing_changed(self) -> Plan:
        """Return the better of the plan and what the same search finds for its own scenario: gains count from there.

        Without it, what a longer search gains would be taken for the worth of a change.
        """
        if self._same is None:
            again = self.solve(self.ledger.scenario, self.ledger.paths_m)
            given = self.ledger.plan
            better = again is not None and again.summary.utility_bps > given.summary.utility_bps
            fewer = again is not None and len(again.unmet_min_rate_slots) <= len(given.unmet_min_rate_slots)
            self._same = again if again is not None and better and fewer else given
        return self._same

    def solve(self, scenario: Scenario, paths_m: Array, *, pinned: bool = True) -> Plan | None:
        """Return a plan of this scenario, from (U, N, 2) paths in metres; `pinned`: held to the pins of the plan.

        None when the budget is spent, time is up before it has converged, or no paths to the ends or around the pinned
        ones are found.
        """
        if not self.may_go_on:
            return None
        if self.stop():
            self.interrupted = True
            return None
        self.count += 1
        rule = AnyOf(converged(), StopToken(self.stop))
        current_m, starts = self.ledger.plan.trajectories_m, self.budget.starts
        pins = self._pins(scenario) if pinned else None
        try:
            made = plan(
                scenario,
                past=self.ledger.past,
                warm_start_m=paths_m,
                pins=pins,
                current_m=current_m,
                n_starts=starts,
                stop=rule,
            )
        except (UnreachableEndError, PinError):
            return None
        if rule.interrupts:  # it is flyable, but less than what the change is worth
            self.interrupted = True
            return None
        return made

    def _pins(self, scenario: Scenario) -> Pins:
        """Return the plan's pins for a changed scenario of the same slots."""
        given = self.ledger.plan
        return carried(given, scenario, given.first_slot, given.trajectories_m).pins if given.pins else given.pins
