"""Flies the drills of some seeds until one breaks something, and prints which: one line of JSON, `null` if none does.

    echo '[1, 2, 3]' | python -m skyfolio.api.lab.torture.hunter

A process of its own, so that it may run with a copy of the package.
"""

from __future__ import annotations

import json
import sys

from skyfolio.api.lab.torture.campaign import begin_worker, one


def main() -> None:
    """Fly, and print."""
    begin_worker()
    for seed in json.load(sys.stdin):
        result = one(seed)
        if result.broken:
            print(json.dumps({"seed": seed, "broken": result.broken}))  # noqa: T201
            return
    print("null")  # noqa: T201


if __name__ == "__main__":
    main()
