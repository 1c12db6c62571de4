"""`sum`: who serves whom in each slot of a large fleet, as an assignment to the users near each UAV.

Everybody's interference counts; only whom a UAV can serve at all is limited to the users nearest to it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import min_weight_full_bipartite_matching
from scipy.spatial import KDTree

from skyfolio.planner.arrays import Array
from skyfolio.planner.fast.arena import entry, plain
from skyfolio.planner.stopping import StoppingRule

Ints: TypeAlias = NDArray[np.int64]
NEAR = 24
"""Users whom a UAV can serve in a slot."""


@dataclass(frozen=True, kw_only=True)
class Match:
    """A task: the links of some slots. gain: (U, S), m^2, 0 for who has left; paths_m: (U, S, 2); user_m: (K, 2)."""

    gain: Array
    paths_m: Array
    altitude_m: Array
    bandwidth_hz: Array
    user_m: Array

    def run(self, stop: StoppingRule) -> tuple[Ints, Array]:  # noqa: ARG002 - it takes a second
        """Return who serves each user, (K, S), and with how many Hz; who gets none belongs to the nearest UAV."""
        n_users, n_slots = len(self.user_m), self.gain.shape[1]
        serving, hertz = np.zeros((n_users, n_slots), dtype=np.int64), np.zeros((n_users, n_slots))
        tree, some = KDTree(self.user_m), min(NEAR, n_users)
        for n in range(n_slots):
            flying = np.flatnonzero(self.gain[:, n] > 0.0)
            at_m = self.paths_m[flying, n]
            near = np.reshape(tree.query(at_m, k=some)[1], (len(flying), some))
            serving[:, n] = flying[KDTree(at_m).query(self.user_m)[1]]
            uav, user = self._matched(flying, at_m, n, near)
            serving[user, n], hertz[user, n] = uav, self.bandwidth_hz[uav]
        return serving, hertz

    def _matched(self, flying: Ints, at_m: Array, n: int, near: Ints) -> tuple[Ints, Ints]:
        """Return UAVs and the distinct users whom they serve."""
        worth = np.empty(near.shape)
        height2 = self.altitude_m[flying] ** 2
        _efficiencies(
            plain(self.gain[flying, n]),
            plain(at_m.T),
            plain(height2),
            plain(self.user_m.T),
            plain(near, np.int64),
            worth,
        )
        worth *= self.bandwidth_hz[flying, None]
        n_uavs, some = near.shape
        nobody = len(self.user_m) + np.arange(n_uavs)  # so that a full matching always exists
        columns = np.concatenate([near, nobody[:, None]], axis=1).ravel()
        cost = np.concatenate([worth.max() + 1.0 - worth, np.full((n_uavs, 1), worth.max() + 1.0)], axis=1).ravel()
        rows = np.repeat(np.arange(n_uavs), some + 1)
        table = csr_matrix((cost, (rows, columns)), shape=(n_uavs, len(self.user_m) + n_uavs))
        row, column = min_weight_full_bipartite_matching(table)
        served = column < len(self.user_m)
        return flying[row[served]], column[served]


@entry
def _efficiencies(gain: Array, at_m: Array, height2: Array, user_m: Array, near: Ints, worth: Array) -> None:
    """log(1 + SINR) of each UAV with the users near it, into `worth` (U, C). gain: (U,); at_m: (2, U); near: (U, C)."""
    heard, known = np.empty(user_m.shape[1]), np.zeros(user_m.shape[1], dtype=np.int64)
    for u in range(near.shape[0]):
        for c in range(near.shape[1]):
            k = near[u, c]
            if known[k] == 0:
                known[k] = 1
                total = 1.0
                for v in range(gain.shape[0]):
                    de, dn = at_m[0, v] - user_m[0, k], at_m[1, v] - user_m[1, k]
                    total += gain[v] / (de * de + dn * dn + height2[v])
                heard[k] = total
            de, dn = at_m[0, u] - user_m[0, k], at_m[1, u] - user_m[1, k]
            own = gain[u] / (de * de + dn * dn + height2[u])
            others = max(heard[k] - own, 1.0)
            worth[u, c] = np.log1p(own / others)
