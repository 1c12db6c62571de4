"""`skyfolio warm-up`: what the set-up runs, so that the first plan on a machine is as fast as any other."""

from __future__ import annotations

import json
import time

from skyfolio.api.cli.files import Json, write
from skyfolio.api.cli.lazy import print_error
from skyfolio.api.common import kernels


def warm_up(as_json: Json = False) -> None:
    """Compile the optimiser's kernels now, so that no later command has to."""
    kernels.report_temporary_folder(print_error)
    began_s = time.perf_counter()
    compiled = kernels.load_all(print_error)
    took_s = round(time.perf_counter() - began_s, 3)
    if as_json:
        write(json.dumps({"compiled": compiled, "seconds": took_s, "folder": str(kernels.folder())}), None)
    else:
        outcome = f"{compiled} kernels compiled" if compiled else "all kernels had been compiled before"
        write(f"{outcome}; ready after {took_s} s", None)
