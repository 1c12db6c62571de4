"""`pooled`: one expectation over slots and users together, times K. It also makes users equal."""

from skyfolio.planner.utilities.kind import Expectation, Kind

POOLED = Kind(
    expectation=Expectation.ALL_USERS,
    rows=lambda rates_kbps: rates_kbps.reshape(1, -1),
    spread=lambda weights, shape: weights.reshape(shape),
    scale=float,
)
