"""Derivatives against finite differences."""

from dataclasses import replace

import numpy as np
import pytest

from skyfolio.planner import Utility, plan
from skyfolio.planner.explanation.ledger import LN2, Ledger
from skyfolio.planner.explanation.prices import head_start_kbps, slope_kbps
from skyfolio.planner.layouts import laid_out


def utility_at(ledger: Ledger, paths_m: np.ndarray) -> float:
    moved = replace(ledger, paths_m=paths_m)
    rates = moved.bandwidth_hz / (1e3 * LN2) * np.log1p(moved.own_snr / (1.0 + moved.total_snr - moved.own_snr))
    return ledger.utility_kbps(rates)


@pytest.mark.parametrize("kind", ["sum", "per_user", "pooled"])
def test_the_slope_is_that_of_the_utility_with_links_kept(kind: str) -> None:
    ledger = Ledger.of(plan(laid_out("uniform", 3, 9, 8, seed=1, utility=Utility(kind=kind, mu_per_kbps=-0.05))))
    for u in range(3):
        slope = slope_kbps(ledger, u)
        for n in range(8):
            for axis in range(2):
                nudge = np.zeros_like(ledger.paths_m)
                nudge[u, n, axis] = 1e-3
                rise = utility_at(ledger, ledger.paths_m + nudge) - utility_at(ledger, ledger.paths_m - nudge)
                assert slope[n, axis] == pytest.approx(rise / 2e-3, rel=1e-4, abs=1e-7)


def test_a_head_start_is_worth_what_the_shifted_path_gives() -> None:
    ledger = Ledger.of(plan(laid_out("uniform", 3, 9, 8, seed=1)))
    for u in range(3):
        shifted = ledger.paths_m.copy()
        shifted[u, :-1] = ledger.paths_m[u, 1:]
        gain, _ = head_start_kbps(ledger, u)
        assert gain == pytest.approx(utility_at(ledger, shifted) - utility_at(ledger, ledger.paths_m), abs=1e-9)
