"""`sum`, eq. (9): one expectation over slots, of the sum rate. It trades between slots, not between users."""

import numpy as np

from skyfolio.planner.utilities.kind import Expectation, Kind

SUM = Kind(
    expectation=Expectation.SLOT_SUMS,
    rows=lambda rates_kbps: np.nansum(rates_kbps, axis=0, keepdims=True),
    spread=np.broadcast_to,
)
