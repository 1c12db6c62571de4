"""`sum`, eq. (9): one expectation over slots, of the sum rate. It trades between slots, not between users.

A user's weight multiplies its rate in the sum.
"""

import numpy as np

from skyfolio.planner.utilities.kind import Expectation, Kind

SUM = Kind(
    expectation=Expectation.SLOT_SUMS,
    rows=lambda rates_kbps, weights: np.nansum(weights[:, None] * rates_kbps, axis=0, keepdims=True),
    spread=lambda shares, shape, weights: weights[:, None] * np.broadcast_to(shares, shape),
    scale=lambda weights: np.ones(1),  # noqa: ARG005
)
