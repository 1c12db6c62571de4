"""Built-in scenarios. `paper` is the letter's simulation; what the letter leaves out is chosen here, and marked so."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from skyfolio.planner.scenario import Channel, Fading, Origin, Scenario, Uav, User, Utility

ZURICH = Origin(lat_deg=47.397742, lon_deg=8.545594)
STARTS_M = ((125.0, 375.0), (375.0, 375.0), (250.0, 125.0))
USERS_PER_UAV = 3
NOISE_DBM = -80.0
USER_RADIUS_M: float | None = 75.0
FADING: Fading = "mean"
LAYOUT_SEED = 13
"""What the letter omits, chosen for its numbers at the mean channel. The study of drawn fading has values of its own
(`api/lab/reproduce/courses.py`, from `skyfolio reproduce --calibrate`)."""


def letter(
    *,
    noise_dbm: float = NOISE_DBM,
    user_radius_m: float | None = USER_RADIUS_M,
    layout_seed: int = LAYOUT_SEED,
    fading: Fading = FADING,
    fading_seed: int = LAYOUT_SEED,
    utility: Utility | None = None,
) -> Scenario:
    """Return the scenario of Section IV of the letter: three UAVs, nine users, twenty slots.

    From the letter: starts, H = 60 m, rho = -20 dB, Rician factor 3 dB, 10 kHz per UAV, D_max = 25 m, D_min = 4 m,
    N = 20, K = 9. Not in the letter, and chosen: the area (500 m x 500 m, which the starts imply), 5 s slots (so D_max
    is 5 m/s), 0.1 W, and everything that is an argument here. user_radius_m: three users are drawn uniformly within
    this many metres of each start, or all of them uniformly over the area when it is None.
    """
    rng = np.random.default_rng(layout_seed)
    area = ((0.0, 0.0), (500.0, 500.0))
    return Scenario(
        origin=ZURICH,
        area_m=area,
        slots=20,
        slot_duration_s=5.0,
        altitude_m=60.0,
        min_separation_m=4.0,
        uavs=tuple(
            Uav(id=f"uav-{i + 1}", start_m=start, max_speed_mps=5.0, bandwidth_hz=10_000.0, transmit_power_w=0.1)
            for i, start in enumerate(STARTS_M)
        ),
        users=tuple(
            User(id=f"user-{index + 1}", position_m=_position(rng, STARTS_M[index // USERS_PER_UAV], user_radius_m))
            for index in range(USERS_PER_UAV * len(STARTS_M))
        ),
        channel=Channel(reference_gain_db=-20.0, noise_dbm=noise_dbm, rician_k_db=3.0, fading=fading, seed=fading_seed),
        utility=utility or Utility(kind="sum", mu_per_kbps=-0.1),
    )


def _position(rng: np.random.Generator, start: tuple[float, float], radius_m: float | None) -> tuple[float, float]:
    first, second = rng.random(), rng.random()
    if radius_m is None:
        return round(500 * float(first), 1), round(500 * float(second), 1)
    radius, angle = radius_m * np.sqrt(first), 2 * np.pi * second
    return round(float(start[0] + radius * np.cos(angle)), 1), round(float(start[1] + radius * np.sin(angle)), 1)


def paper() -> Scenario:
    """Return the letter's scenario for planning and flying: mean channel, users within 75 m of the starts, -80 dBm.

    The letter's numbers are met by averages over drawn fading, which no single scenario can be: a scenario has one
    channel, and a fleet that flies it knows the mean of the gains and not what will be drawn.
    """
    return letter()


def minimal() -> Scenario:
    """Return two UAVs and four users on four slots: small enough to follow by hand."""
    return Scenario(
        origin=ZURICH,
        area_m=((0.0, 0.0), (200.0, 100.0)),
        slots=4,
        slot_duration_s=5.0,
        altitude_m=30.0,
        min_separation_m=4.0,
        uavs=(Uav(id="uav-1", start_m=(50.0, 50.0)), Uav(id="uav-2", start_m=(150.0, 50.0))),
        users=tuple(
            User(id=f"user-{i + 1}", position_m=at)
            for i, at in enumerate(((20.0, 50.0), (60.0, 60.0), (140.0, 60.0), (180.0, 50.0)))
        ),
    )


EXAMPLES: dict[str, Callable[[], Scenario]] = {"paper": paper, "minimal": minimal}
