"""`pooled`: one expectation over slots and users together, times K. It also makes users equal.

A user's weight is how often it counts in the expectation; times the sum of all weights in place of K.
"""

import numpy as np

from skyfolio.planner.utilities.kind import Expectation, Kind

POOLED = Kind(
    expectation=Expectation.ALL_USERS,
    rows=lambda rates_kbps, weights: rates_kbps.reshape(1, -1),  # noqa: ARG005
    spread=lambda shares, shape, weights: shares.reshape(shape),  # noqa: ARG005
    scale=lambda weights: weights.sum(keepdims=True),
    counts=lambda shape, weights: np.broadcast_to(weights[:, None], shape).reshape(1, -1),
)
