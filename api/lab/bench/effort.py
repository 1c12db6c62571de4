"""How much the planner's benchmark measures: `quick` takes a few minutes, the default 25, `full` more than an hour."""

from __future__ import annotations

from dataclasses import dataclass

from skyfolio.api.lab.bench.instances import LAYOUTS, Instance, Size, instances, standard

MIDDLE, LARGE = 15, 40
"""From so many UAVs on less is repeated: one plan takes seconds, and there are eight layouts of three utilities."""


@dataclass(frozen=True, kw_only=True)
class Effort:
    """What a run may take.

    sizes: how many of the sizes, from the smallest. runs, budget_s: of each timing of the `fast` section. yardsticks:
    on how many sizes each yardstick runs; runs_of_yardsticks: how often. small_layouts: of ablation and proof.
    layouts: of the quality instances. plan_runs: timed calls of one plan up to LARGE. multiples: budgets, on so many
    layouts (small, middle and large fleets). peers_s: for each peer. bound_s: for each proof; bound_seeds: layouts with
    a greater seed are left out. disruption_layouts, ground_layouts: of each size. checked: scenarios.
    """

    name: str
    sizes: int = 4
    runs: int = 100
    budget_s: float = 2.0
    yardsticks: dict[tuple[str, str], int]
    runs_of_yardsticks: int = 3
    starts_of_ipopt: int = 50
    small_layouts: int = 8
    layouts: int = len(LAYOUTS)
    plan_runs: int = 3
    multiples: tuple[int, ...] = (2, 10)
    multiple_layouts: tuple[int, int, int] = (3, 2, 1)
    peers_s: float = 10.0
    bound_s: float = 60.0
    bound_seeds: int = 1
    disruption_layouts: tuple[int, int, int] = (3, 1, 1)
    ground_layouts: tuple[int, int, int] = (6, 3, 1)
    checked: int = 500

    def instances(self, size: Size, kind: str) -> list[Instance]:
        """Return the quality instances of one size and utility, those with other mu and noise too."""
        within = LAYOUTS[: self.layouts]
        return [one for one in instances(size) if one.kind == kind and (one.layout, one.seed) in within]

    def proven(self, size: Size, kind: str) -> list[Instance]:
        """Return those whose bound is proven as tightly as the time allows."""
        return [one for one in standard(size, kind) if one.seed <= self.bound_seeds]

    def with_multiples(self, size: Size, kind: str) -> list[Instance]:
        """Return those that are planned with multiples of the default budget, too."""
        return standard(size, kind)[: self.multiple_layouts[class_of(size)]]

    def disrupted(self, size: Size, kind: str) -> list[Instance]:
        """Return those that are replanned at a price for changes."""
        return standard(size, kind)[: self.disruption_layouts[class_of(size)]]

    def multiples_of(self, size: Size) -> tuple[int, ...]:
        """Return the multiples of the default budget; large fleets do without the greatest."""
        return self.multiples[:1] if class_of(size) == 2 and self.name != FULL.name else self.multiples


def class_of(size: Size) -> int:
    """Return 0 for a small fleet, 1 for a middle one and 2 for a large one."""
    return (size[0] >= MIDDLE) + (size[0] >= LARGE)


DEFAULT = Effort(
    name="default",
    yardsticks={("reference", "sum"): 1, ("reference", "per_user"): 1, ("ipopt", "sum"): 2, ("ipopt", "per_user"): 1},
)
QUICK = Effort(
    name="quick",
    sizes=2,
    runs=5,
    yardsticks={(yardstick, kind): 1 for yardstick in ("reference", "ipopt") for kind in ("sum", "per_user")},
    runs_of_yardsticks=1,
    starts_of_ipopt=0,
    small_layouts=2,
    layouts=1,
    multiple_layouts=(1, 1, 1),
    multiples=(2,),
    peers_s=1.0,
    bound_s=2.0,
    disruption_layouts=(1, 1, 1),
    ground_layouts=(1, 1, 1),
    checked=20,
)
FULL = Effort(
    name="full",
    runs=200,
    budget_s=6.0,
    yardsticks=DEFAULT.yardsticks | {("ipopt", "sum"): 3},
    plan_runs=5,
    multiple_layouts=(8, 8, 2),
    peers_s=20.0,
    bound_seeds=3,
    disruption_layouts=(8, 3, 1),
)
EFFORTS = {one.name: one for one in (QUICK, DEFAULT, FULL)}
