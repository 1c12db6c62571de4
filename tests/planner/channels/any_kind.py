"""Channels of all kinds for tests."""

from __future__ import annotations

from typing import Any

import numpy as np


def shadowed(*levels_m: float, **fields: Any) -> dict[str, Any]:
    """Return a map with shadows of 6 dB for four receivers, on a grid of 50 m from (-50, -50) to (850, 850)."""
    rng = np.random.default_rng(3)
    receivers = np.array([(100.0, 100.0), (400.0, 150.0), (200.0, 420.0), (600.0, 300.0)])
    places = np.arange(-50.0, 851.0, 50.0)
    east, north = np.meshgrid(places, places)
    over2 = (east - receivers[:, 0, None, None]) ** 2 + (north - receivers[:, 1, None, None]) ** 2
    squared = over2[:, None] + np.square(levels_m)[:, None, None]
    gains_db = -20.0 - 10.0 * np.log10(squared) + rng.normal(0.0, 6.0, squared.shape)
    return {
        "kind": "map",
        "receivers_m": receivers.tolist(),
        "levels_m": list(levels_m),
        "south_west_m": (-50.0, -50.0),
        "spacing_m": 50.0,
        "gains_db": gains_db.round(2).tolist(),
        **fields,
    }


CHANNELS: dict[str, dict[str, Any]] = {
    "letter, beam": {"noise_dbm": -55.0, "antenna": {"kind": "beam", "beamwidth_deg": 40.0}},
    "letter, ring": {"noise_dbm": -55.0, "antenna": {"kind": "beam", "tilt_deg": 30.0, "beamwidth_deg": 20.0}},
    "letter, dipole": {"noise_dbm": -55.0, "antenna": {"kind": "dipole"}},
    "suburban": {"kind": "los_probability", "environment": "suburban", "noise_figure_db": 9.0},
    "highrise, sampled": {
        "kind": "los_probability",
        "environment": "highrise",
        "noise_dbm": -110.0,
        "fading": "sampled",
        "seed": 4,
    },
    "UMa-AV": {"kind": "3gpp_uav", "noise_figure_db": 9.0},
    "UMi-AV, expected": {
        "kind": "3gpp_uav",
        "environment": "UMi-AV",
        "noise_dbm": -100.0,
        "fading": "expected",
        "draws": 5,
    },
    "RMa-AV, beam": {
        "kind": "3gpp_uav",
        "environment": "RMa-AV",
        "carrier_hz": 7e8,
        "noise_dbm": -95.0,
        "antenna": {"kind": "beam"},
    },
    "map": shadowed(50.0, 80.0, noise_dbm=-55.0),
    "map, sampled": shadowed(60.0, noise_dbm=-55.0, fading="sampled", seed=5),
    "map, expected": shadowed(60.0, noise_dbm=-55.0, fading="expected", draws=5, antenna={"kind": "dipole"}),
}
