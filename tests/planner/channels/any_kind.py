"""Channels of all kinds for tests."""

from __future__ import annotations

from typing import Any

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
}
