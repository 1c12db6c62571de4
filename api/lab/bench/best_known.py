"""The best known utility of each instance of the quality benchmark: improved when beaten, never lowered.

`python -m skyfolio.api.lab.bench.best_known [--seconds S] [--only TEXT]` searches on, instance by instance, and
writes the file whole after each. It may be interrupted at any time and started again: what was searched as long with
the same seed before is passed over (`--again` searches it anew).
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

from skyfolio.planner import AnyOf, Deadline, MaxIterations, RelativeGain, Scenario, Utility
from skyfolio.planner.fast import optimise
from skyfolio.planner.layouts import laid_out
from skyfolio.planner.problem import problem_of
from skyfolio.planner.rehearsal import rehearse

Table: TypeAlias = dict[str, dict[str, Any]]
FILE = Path(__file__).resolve().parents[3] / "docs" / "benchmarks" / "best-known.json"
MARGIN = 1e-9
"""Relative: less is rounding."""

UTILITIES = (("sum", 0.0), ("per_user", -0.1), ("pooled", -0.5))
STEADIER = (("sum", -0.05), ("pooled", -0.05))
"""Further utilities, on the first two layouts."""
LAYOUTS = (
    *(("uniform", seed) for seed in (1, 2, 3)),
    *(("clustered", seed) for seed in (1, 2)),
    ("stadium", 1),
    ("corridor", 1),
    ("two_towns", 1),
)


@dataclass(frozen=True)
class Instance:
    """One problem of the quality benchmark; noise -60 dBm, area 500 m x sqrt(U/3) square."""

    size: tuple[int, int, int]
    layout: str
    seed: int
    kind: str
    mu_per_kbps: float

    @property
    def name(self) -> str:
        """As in the file: `10x100x50 uniform-1 sum 0`."""
        return f"{'x'.join(map(str, self.size))} {self.layout}-{self.seed} {self.kind} {self.mu_per_kbps:g}"

    def scenario(self) -> Scenario:
        """Return the scenario itself."""
        utility = Utility.model_validate({"kind": self.kind, "mu_per_kbps": self.mu_per_kbps})
        return laid_out(self.layout, *self.size, seed=self.seed, utility=utility)


def instances(size: tuple[int, int, int]) -> list[Instance]:
    """Return all instances of one size: every utility on every layout, and steadier ones on the first two."""
    return [
        Instance(size, layout, seed, kind, mu)
        for index, (layout, seed) in enumerate(LAYOUTS)
        for kind, mu in (*UTILITIES, *(STEADIER if index < 2 else ()))
    ]


def load(path: Path = FILE) -> Table:
    """Return the table: by instance, `utility_kbps`, `found_by`, `seconds`."""
    table: Table = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    return table


def improve(instance: Instance, utility_kbps: float, found_by: str, seconds: float, path: Path = FILE) -> bool:
    """Note a value if it beats what is known; whether it did. The file is read anew, so that several may write."""
    table = load(path)
    known = table.get(instance.name)
    if known is not None and utility_kbps <= known["utility_kbps"] * (1.0 + MARGIN):
        return False
    table[instance.name] = {
        **({"searched": known["searched"]} if known and "searched" in known else {}),
        "utility_kbps": round(utility_kbps, 6),
        "found_by": found_by,
        "seconds": round(seconds, 1),
    }
    _write(table, path)
    return True


def searched(instance: Instance, seconds: float, seed: int, path: Path = FILE) -> bool:
    """Return whether a search with this seed has already had so many seconds, whatever it found."""
    known = load(path).get(instance.name, {})
    return bool(known.get("searched", {}).get(str(seed), 0.0) >= seconds)


def note_search(instance: Instance, seconds: float, seed: int, path: Path = FILE) -> None:
    """Note that a search has come to its end, so that it need not be run again."""
    table = load(path)
    done = table[instance.name].setdefault("searched", {})
    done[str(seed)] = max(seconds, done.get(str(seed), 0.0))
    _write(table, path)


def _write(table: Table, path: Path) -> None:
    """Replace the file, whole or not at all."""
    written = path.with_suffix(f".{os.getpid()}.new")
    written.write_text(json.dumps(dict(sorted(table.items())), indent=1) + "\n", encoding="utf-8")
    written.replace(path)


def search(instance: Instance, seconds: float, seed: int, clock: Callable[[], float] = time.process_time) -> float:
    """Return the best utility (kbit/s) of a long search by the planner; kernels are compiled before time counts."""
    rehearse()
    stop = AnyOf(MaxIterations(50), RelativeGain(1e-5), Deadline(seconds, clock=clock))
    found = optimise(problem_of(instance.scenario()), stop, n_starts=10_000_000, seed=seed)
    return found.history[-1].utility_bps / 1e3


def main() -> None:
    """Search on and say what was beaten."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=600.0, help="of processor time, for each instance")
    parser.add_argument("--sizes", default="10x100x50,20x300x100,50x1000x100")
    parser.add_argument("--only", default="", help="instances whose name contains this")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--again", action="store_true", help="search what was searched as long before, too")
    given = parser.parse_args()
    for text in given.sizes.split(","):
        n_uavs, n_users, n_slots = (int(part) for part in text.split("x"))
        for instance in instances((n_uavs, n_users, n_slots)):
            if given.only not in instance.name:
                continue
            if not given.again and searched(instance, given.seconds, given.seed):
                print(f"{instance.name}: searched before", flush=True)  # noqa: T201
                continue
            value = search(instance, given.seconds, given.seed)
            better = improve(instance, value, f"planner, seed {given.seed}, {given.seconds:g} s", given.seconds)
            note_search(instance, given.seconds, given.seed)
            print(f"{instance.name}: {value:.3f} {'best so far' if better else ''}", flush=True)  # noqa: T201


if __name__ == "__main__":
    main()
