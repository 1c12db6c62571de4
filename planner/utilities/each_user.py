"""`per_user`: an expectation over slots for each user, whose sum has eq. (5) as its expansion. It steadies users.

A user's weight multiplies its expectation in the sum: its mean and its variance alike.
"""

from skyfolio.planner.utilities.kind import Expectation, Kind

PER_USER = Kind(
    expectation=Expectation.EACH_USER,
    rows=lambda rates_kbps, weights: rates_kbps,  # noqa: ARG005
    spread=lambda shares, shape, weights: shares.reshape(shape),  # noqa: ARG005
    scale=lambda weights: weights,
)
