"""The best known utility of each instance of the quality benchmark: improved when beaten, never lowered.

`python -m skyfolio.api.lab.bench.best_known [--seconds S] [--only TEXT]` searches on, instance by instance, and
writes the file whole after each. It may be interrupted at any time and started again: what was searched as long with
the same seed before is passed over (`--again` searches it anew).
"""

from __future__ import annotations

import argparse
import fcntl
import json
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeAlias

from skyfolio.api.lab.bench.instances import FLEETS, Instance, instances, size_of, text_of
from skyfolio.planner import AnyOf, Deadline, MaxIterations, RelativeGain
from skyfolio.planner.fast import optimise
from skyfolio.planner.problem import problem_of
from skyfolio.planner.rehearsal import rehearse

Table: TypeAlias = dict[str, dict[str, Any]]
FILE = Path(__file__).resolve().parents[3] / "docs" / "benchmarks" / "best-known.json"
MARGIN = 1e-8
"""Relative: less is rounding, because the file has six decimals."""


def load(path: Path = FILE) -> Table:
    """Return the table: by instance, `utility_kbps`, `found_by`, `seconds`."""
    table: Table = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    return table


def improve(name: str, utility_kbps: float, found_by: str, seconds: float, path: Path = FILE) -> bool:
    """Note a value of an instance if it beats what is known; whether it did."""
    with _changing(path) as table:
        known = table.get(name)
        if known is not None and utility_kbps <= known["utility_kbps"] * (1.0 + MARGIN):
            return False
        table[name] = {
            **({"searched": known["searched"]} if known and "searched" in known else {}),
            "utility_kbps": round(utility_kbps, 6),
            "found_by": found_by,
            "seconds": round(seconds, 1),
        }
    return True


def searched(instance: Instance, seconds: float, seed: int, path: Path = FILE) -> bool:
    """Return whether a search with this seed has already had so many seconds, whatever it found."""
    known = load(path).get(instance.name, {})
    return bool(known.get("searched", {}).get(str(seed), 0.0) >= seconds)


def note_search(instance: Instance, seconds: float, seed: int, path: Path = FILE) -> None:
    """Note that a search has come to its end, so that it need not be run again."""
    with _changing(path) as table:
        done = table[instance.name].setdefault("searched", {})
        done[str(seed)] = max(seconds, done.get(str(seed), 0.0))


@contextmanager
def _changing(path: Path) -> Iterator[Table]:
    """Give the table as it is now and replace the file, whole or not at all; one process at a time, so none is lost."""
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        fcntl.flock(folder, fcntl.LOCK_EX)
        table = load(path)
        yield table
        _write(table, path)
    finally:
        os.close(folder)


def _write(table: Table, path: Path) -> None:
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
    parser.add_argument("--sizes", default=",".join(map(text_of, FLEETS)))
    parser.add_argument("--only", default="", help="instances whose name contains this")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--again", action="store_true", help="search what was searched as long before, too")
    given = parser.parse_args()
    for text in given.sizes.split(","):
        for instance in instances(size_of(text)):
            if given.only not in instance.name:
                continue
            if not given.again and searched(instance, given.seconds, given.seed):
                print(f"{instance.name}: searched before", flush=True)  # noqa: T201
                continue
            value = search(instance, given.seconds, given.seed)
            better = improve(instance.name, value, f"planner, seed {given.seed}, {given.seconds:g} s", given.seconds)
            note_search(instance, given.seconds, given.seed)
            print(f"{instance.name}: {value:.3f} {'best so far' if better else ''}", flush=True)  # noqa: T201


if __name__ == "__main__":
    main()
