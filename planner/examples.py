"""Built-in scenarios. `paper` is the letter's simulation; what the letter leaves out is chosen here, and marked so."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from skyfolio.planner.scenario import Channel, Fading, Origin, Scenario, Uav, User, Utility

ZURICH = Origin(lat_deg=47.397742, lon_deg=8.545594)
STARTS_M = ((125.0, 375.0), (375.0, 375.0), (250.0, 125.0))
USERS_PER_UAV = (3, 3, 3)
NOISE_DBM = -80.0
USER_RADIUS_M: float | None = 75.0
FADING: Fading = "mean"
LAYOUT_SEED = 13
"""What the letter omits, chosen for planning and flying at the mean channel. The letter's numbers, which are averages
over drawn fading, have values of their own (`calibrated`; `api/lab/reproduce/courses.py` averages over layouts and
draws)."""


def letter(
    *,
    noise_dbm: float = NOISE_DBM,
    user_radius_m: float | None = USER_RADIUS_M,
    users_per_uav: Sequence[int] = USERS_PER_UAV,
    layout_seed: int = LAYOUT_SEED,
    fading: Fading = FADING,
    fading_seed: int = LAYOUT_SEED,
    utility: Utility | None = None,
) -> Scenario:
    """Return the scenario of Section IV of the letter: three UAVs, nine users, twenty slots.

    From the letter: starts, H = 60 m, rho = -20 dB, Rician factor 3 dB, 10 kHz per UAV, D_max = 25 m, D_min = 4 m,
    N = 20, K = 9. Not in the letter, and chosen: the area (500 m x 500 m, which the starts imply), 5 s slots (so D_max
    is 5 m/s), 0.1 W, and everything that is an argument here. users_per_uav: how many users are near each start.
    user_radius_m: they are drawn uniformly within this many metres of it, or all of them uniformly over the area when
    it is None. Raises ValueError unless there is one number for each UAV.
    """
    rng = np.random.default_rng(layout_seed)
    near = [start for start, n_users in zip(STARTS_M, users_per_uav, strict=True) for _ in range(n_users)]
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
            User(id=f"user-{index + 1}", position_m=_position(rng, start, user_radius_m))
            for index, start in enumerate(near)
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

    A fleet that flies knows the mean of the gains and not what will be drawn. The calibration does not move its users:
    under no layout does the mean channel come near the letter's numbers, which are averages over drawn fading.
    """
    return letter()


def calibrated() -> Scenario:
    """Return the scenario that fits the letter's numbers best (`skyfolio reproduce --calibrate`), in one draw.

    The numbers are met by the mean over 24 draws (`channel.seed` 100, 1100, ...) and many layouts; this is the first
    draw of the first layout on which the study judges the letter's claims.
    """
    return letter(users_per_uav=(2, 3, 4), user_radius_m=100.0, layout_seed=100, fading="sampled", fading_seed=100)


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


EXAMPLES: dict[str, Callable[[], Scenario]] = {"paper": paper, "calibrated": calibrated, "minimal": minimal}
