"""The instances of the quality benchmark: sizes, layouts of users, utilities and noise."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

from skyfolio.planner import Scenario, Utility
from skyfolio.planner.layouts import laid_out

Size: TypeAlias = tuple[int, int, int]

LETTER: Size = (3, 9, 20)
FLEETS: tuple[Size, ...] = ((10, 100, 50), (20, 300, 100), (50, 1000, 100))
"""U x K x N, growing."""
UTILITIES = (("sum", 0.0), ("per_user", -0.1), ("pooled", -0.5))
STEADIER = (("sum", -0.05), ("pooled", -0.05))
"""Further utilities, on the first two layouts."""
NOISE_DBM = -60.0
OTHER_NOISE_DBM = (-80.0, -70.0, -50.0)
"""On the first layout of the smallest fleet, so that the run stays affordable."""
LAYOUTS = (
    *(("uniform", seed) for seed in (1, 2, 3)),
    *(("clustered", seed) for seed in (1, 2)),
    ("stadium", 1),
    ("corridor", 1),
    ("two_towns", 1),
)


@dataclass(frozen=True)
class Instance:
    """One problem of the quality benchmark; area 500 m x sqrt(U/3) square."""

    size: Size
    layout: str
    seed: int
    kind: str
    mu_per_kbps: float
    noise_dbm: float = NOISE_DBM

    @property
    def name(self) -> str:
        """As in the file of best known values: `10x100x50 uniform-1 sum 0`, and the noise if it is not the usual."""
        noise = "" if self.noise_dbm == NOISE_DBM else f" {self.noise_dbm:g} dBm"
        return f"{text_of(self.size)} {self.layout}-{self.seed} {self.kind} {self.mu_per_kbps:g}{noise}"

    @property
    def standard(self) -> bool:
        """Whether it counts in the means that are asked for: the utility's main mu, and the usual noise."""
        return (self.kind, self.mu_per_kbps) in UTILITIES and self.noise_dbm == NOISE_DBM

    def scenario(self) -> Scenario:
        """Return the scenario itself."""
        utility = Utility.model_validate({"kind": self.kind, "mu_per_kbps": self.mu_per_kbps})
        return laid_out(self.layout, *self.size, seed=self.seed, utility=utility, noise_dbm=self.noise_dbm)


def instances(size: Size) -> list[Instance]:
    """Return all instances of one size: every utility on every layout, and other mu and noise on the first ones."""
    chosen = [
        Instance(size, layout, seed, kind, mu)
        for index, (layout, seed) in enumerate(LAYOUTS)
        for kind, mu in (*UTILITIES, *(STEADIER if index < 2 else ()))
    ]
    noises = OTHER_NOISE_DBM if size == FLEETS[0] else ()
    return chosen + [Instance(size, *LAYOUTS[0], kind, mu, noise) for noise in noises for kind, mu in UTILITIES]


def standard(size: Size, kind: str) -> list[Instance]:
    """Return the instances of one size and utility over whose layouts means are taken."""
    return [one for one in instances(size) if one.kind == kind and one.standard]


def text_of(size: Size) -> str:
    """Return a size as it is written: `10x100x50`."""
    return "x".join(map(str, size))


def size_of(text: str) -> Size:
    """Return the size that is written so. Raises ValueError for anything but three positive numbers."""
    try:
        n_uavs, n_users, n_slots = (int(part) for part in text.split("x"))
    except ValueError:
        raise ValueError(f"size: {text!r} must be UxKxN, such as 10x100x50") from None
    if min(n_uavs, n_users, n_slots) < 1:
        raise ValueError(f"size: {text!r} must have at least one UAV, user and slot")
    return n_uavs, n_users, n_slots
