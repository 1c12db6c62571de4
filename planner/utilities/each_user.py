"""`per_user`: an expectation over slots for each user, whose sum has eq. (5) as its expansion. It steadies users."""

from skyfolio.planner.utilities.kind import Expectation, Kind

PER_USER = Kind(
    expectation=Expectation.EACH_USER,
    rows=lambda rates_kbps: rates_kbps,
    spread=lambda weights, shape: weights.reshape(shape),
)
