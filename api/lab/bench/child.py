"""One part alone in its process, which prints as JSON its figures and what processor time the process took.

python -m skyfolio.api.lab.bench.child SECTION UxKxN KIND [--effort NAME] [--core N]
"""

from __future__ import annotations

import argparse
import json
import sys
import time

from skyfolio.api.lab.bench.effort import EFFORTS
from skyfolio.api.lab.bench.instances import size_of
from skyfolio.api.lab.bench.measure import pin_to_core
from skyfolio.api.lab.bench.parts import SECTIONS, Part


def main() -> None:
    """Measure, print, and exit."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("section", choices=SECTIONS)
    parser.add_argument("size", type=size_of)
    parser.add_argument("kind")
    parser.add_argument("--effort", choices=EFFORTS, default="default")
    parser.add_argument("--core", type=int)
    given = parser.parse_args()
    if given.core is not None:
        pin_to_core(given.core)
    figures = Part(given.section, given.size, given.kind).measure(EFFORTS[given.effort])
    json.dump({"cpu_s": round(time.process_time(), 1), "figures": figures}, sys.stdout)


if __name__ == "__main__":
    main()
