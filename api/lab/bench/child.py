"""One case alone in its process, which prints its figures as JSON.

python -m skyfolio.api.lab.bench.child CASE UxKxN KIND [--quick]
"""

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
    arguments = parser.parse_args()
    n_uavs, n_users, n_slots = (int(part) for part in arguments.size.split("x"))
    pin_to_one_core()
    json.dump(CASES[arguments.case]((n_uavs, n_users, n_slots), arguments.kind, quick=arguments.quick), sys.stdout)


if __name__ == "__main__":
    main()
