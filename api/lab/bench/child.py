"""One case alone in its process: `python -m api.bench.child CASE UxKxN KIND [--quick]` prints its figures as JSON."""

from __future__ import annotations

import argparse
import json
import sys

from skyfolio.api.lab.bench.cases import CASES
from skyfolio.api.lab.bench.measure import pin_to_one_core


def main() -> None:
    """Measure, print, and exit."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("case", choices=CASES)
    parser.add_argument("size")
    parser.add_argument("kind")
    parser.add_argument("--quick", action="store_true")
    given = parser.parse_args()
    n_uavs, n_users, n_slots = (int(part) for part in given.size.split("x"))
    pin_to_one_core()
    json.dump(CASES[given.case]((n_uavs, n_users, n_slots), given.kind, quick=given.quick), sys.stdout)


if __name__ == "__main__":
    main()
