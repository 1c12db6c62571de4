"""Ready scenarios. `paper` is the letter's simulation; what the letter leaves out is chosen here and said so."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from planner.scenario import Channel, Origin, Scenario, Uav, User, Utility

ZURICH = Origin(lat_deg=47.397742, lon_deg=8.545594)
USER_SEED = 11
USER_RADIUS_M = 90.0


def paper() -> Scenario:
    """Three UAVs, nine users, twenty slots: section IV of the letter.

    From the letter: starts, H = 60 m, rho = -20 dB, Rician factor 3 dB, 10 kHz per UAV, D_max = 25 m, D_min = 4 m,
    N = 20, K = 9. Not in the letter, and chosen: the area (500 m x 500 m, which the starts imply), 5 s slots (so
    D_max is 5 m/s), 0.1 W, noise of -55 dBm (at which losing a UAV costs sum rate, as in its Fig. 3; much below it the
    fleet is limited by its own interference and a loss costs nearly nothing), mean fading, three users drawn
    uniformly within 90 m of each start, and mu = -0.1 per kbit/s.
    """
    starts = ((125.0, 375.0), (375.0, 375.0), (250.0, 125.0))
    rng = np.random.default_rng(USER_SEED)
    users = []
    for index in range(9):
        radius, angle = USER_RADIUS_M * np.sqrt(rng.random()), 2 * np.pi * rng.random()
        e, n = starts[index // 3][0] + radius * np.cos(angle), starts[index // 3][1] + radius * np.sin(angle)
        users.append(User(id=f"user-{index + 1}", position_m=(round(float(e), 1), round(float(n), 1))))
    return Scenario(
        origin=ZURICH,
        area_m=((0.0, 0.0), (500.0, 500.0)),
        slots=20,
        slot_duration_s=5.0,
        altitude_m=60.0,
        min_separation_m=4.0,
        uavs=tuple(
            Uav(id=f"uav-{i + 1}", start_m=start, max_speed_mps=5.0, bandwidth_hz=10_000.0, transmit_power_w=0.1)
            for i, start in enumerate(starts)
        ),
        users=tuple(users),
        channel=Channel(reference_gain_db=-20.0, noise_dbm=-55.0, rician_k_db=3.0, fading="mean", seed=USER_SEED),
        utility=Utility(kind="sum", mu_per_kbps=-0.1),
    )


def minimal() -> Scenario:
    """Two UAVs and four users on four slots: small enough to follow by hand."""
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
