"""The yardstick: trajectories by IPOPT through CasADi, a general interior point solver for smooth problems.

CasADi is a development dependency: nothing in the product needs it.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from skyfolio.planner.arrays import Array
from skyfolio.planner.problem import Problem
from skyfolio.planner.sinr import spectral_efficiency
from skyfolio.planner.utilities import Expectation, kind_of

Shares = Callable[[Array], tuple[NDArray[np.intp], Array]]
"""From paths (U, N, 2) to the best serving UAV and bandwidth, each (K, N)."""

OPTIONS = {
    "print_time": False,
    "ipopt.print_level": 0,
    "ipopt.sb": "yes",
    "ipopt.tol": 1e-6,
    "ipopt.acceptable_tol": 1e-4,
    "ipopt.max_iter": 500,
}


@dataclass
class Trajectories:
    """max G over Q for given A and B as one nonlinear program, built once for a problem and solved for any A, B.

    The variables are the positions from slot 1 on and what the utility counts: the sum rate of each slot for `sum`,
    else the rate of each link, tied to the positions by constraints, so that the Hessian stays sparse. (6f) are bounds,
    (6d) constraints; D_min (6e) and everything beyond the letter is left out, which only makes it easier. Only pairs
    with bandwidth enter: `links` of them in each slot, given as parameters (user position, gains, server, kHz).
    """

    problem: Problem
    links: int
    build_s: float = 0.0
    _solver: Any = field(init=False)

    def __post_init__(self) -> None:
        began = time.perf_counter()
        problem, n_moves = self.problem, self.problem.n_slots - 1
        q = ca.MX.sym("q", 2 * problem.n_uavs, n_moves)
        given = ca.MX.sym("given", self._width, problem.n_slots)
        fixed = ca.DM(problem.start_m.reshape(-1, 1))
        self._rates = _slot_rates(problem, self.links, total=self._by_slot).map(problem.n_slots)
        rates = self._rates(ca.horzcat(fixed, q), given)
        y = ca.MX.sym("y", *rates.shape)
        steps = ca.horzcat(q[:, 0] - fixed, q[:, 1:] - q[:, :-1])
        moved2 = ca.vertcat(*[steps[2 * u, :] ** 2 + steps[2 * u + 1, :] ** 2 for u in range(problem.n_uavs)])
        program: dict[str, Any] = {
            "x": ca.vertcat(ca.vec(q), ca.vec(y)),
            "p": ca.vec(given),
            "f": -_utility(problem, y),
            "g": ca.vertcat(ca.vec(moved2), ca.vec(y - rates)),
        }
        self._solver = ca.nlpsol("trajectories", "ipopt", program, OPTIONS)  # type: ignore[arg-type]
        free, tied = np.full(y.numel(), np.inf), np.zeros(y.numel())
        self._limits = {
            "lbx": np.concatenate([np.tile(problem.low_m, problem.n_uavs * n_moves), -free]),
            "ubx": np.concatenate([np.tile(problem.high_m, problem.n_uavs * n_moves), free]),
            "lbg": np.concatenate([np.full(moved2.numel(), -np.inf), tied]),
            "ubg": np.concatenate([np.tile(problem.step_m**2, n_moves), tied]),
        }
        self.build_s = time.perf_counter() - began

    @property
    def _by_slot(self) -> bool:
        return kind_of(self.problem.kind).expectation == Expectation.SLOT_SUMS or self.problem.mu == 0.0

    @property
    def _width(self) -> int:
        """Return the numbers per slot in `given`: coordinates (2) and kHz of each link, its gain and server per UAV."""
        return self.links * (3 + 2 * self.problem.n_uavs)

    def solve(self, paths_m: Array, serving: NDArray[np.intp], bandwidth_hz: Array) -> Array:
        """Return the paths (U, N, 2) for the given association and bandwidth (K, N), from `paths_m`."""
        parameters = self._given(serving, bandwidth_hz)
        positions = paths_m.transpose(1, 0, 2).reshape(self.problem.n_slots, -1)
        rates = np.asarray(self._rates(positions.T, parameters.T)).T.ravel()
        start = np.concatenate([positions[1:].ravel(), rates])
        solution = np.asarray(self._solver(x0=start, p=parameters.ravel(), **self._limits)["x"])
        moved = solution[: positions[1:].size].reshape(-1, self.problem.n_uavs, 2).transpose(1, 0, 2)
        return np.concatenate([self.problem.start_m[:, None], moved], axis=1)

    def _given(self, serving: NDArray[np.intp], bandwidth_hz: Array) -> Array:
        problem = self.problem
        columns = []
        for n in range(problem.n_slots):
            users = _linked(bandwidth_hz[:, n], self.links)
            server = np.eye(problem.n_uavs)[serving[users, n]]
            columns.append(
                np.concatenate(
                    [
                        problem.user_m[users, 0].ravel(),
                        bandwidth_hz[users, n] / 1e3,
                        problem.snr_gain[:, users, n].T.ravel(),
                        server.ravel(),
                    ]
                )
            )
        return np.stack(columns)


def alternate(
    problem: Problem,
    shares: Shares,
    start_m: Array,
    links: int,
    *,
    passes: int = 20,
    program: Trajectories | None = None,
) -> dict[str, Any]:
    """Alternate A and B by `shares` with Q by IPOPT until less than 0.01 % is gained, from `start_m`.

    Returns the utility (kbit/s), the paths, and the seconds to build the program and to solve, the latter for
    IPOPT's calls alone.
    """
    program = program or Trajectories(problem, links)
    paths, best, solving, busy, done = start_m, -np.inf, 0.0, 0.0, 0
    while done < passes:
        done += 1
        serving, bandwidth = shares(paths)
        began, cpu = time.perf_counter(), time.process_time()
        moved = program.solve(paths, serving, bandwidth)
        solving, busy = solving + time.perf_counter() - began, busy + time.process_time() - cpu
        value = utility_of(problem, moved, *shares(moved))
        if value <= best:
            break
        gained = value - best
        best, paths = value, moved
        if gained <= 1e-4 * abs(best):
            break
    return {
        "utility_kbps": best,
        "paths_m": paths,
        "passes": done,
        "build_s": program.build_s,
        "solve_s": solving,
        "solve_cpu_s": busy,
    }


def utility_of(problem: Problem, paths_m: Array, serving: NDArray[np.intp], bandwidth_hz: Array) -> float:
    """Return the true utility of paths, association and bandwidth, kbit/s."""
    efficiency = np.take_along_axis(spectral_efficiency(problem, paths_m), serving[None], axis=0)[0]
    return problem.utility_kbps(bandwidth_hz * efficiency / 1e3)


def _linked(bandwidth_hz: Array, links: int) -> NDArray[np.intp]:
    """Return the users with most bandwidth, in user order: all that have any."""
    most = np.argsort(-bandwidth_hz, kind="stable")[:links]
    return np.asarray(np.sort(most))


def _slot_rates(problem: Problem, links: int, *, total: bool) -> Any:
    """Return the rate of each link or their total, kbit/s (eqs. 1-4), from positions (2 U) and `given` of one slot."""
    n_uavs = problem.n_uavs
    q, parameters = ca.SX.sym("q", 2 * n_uavs), ca.SX.sym("given", links * (3 + 2 * n_uavs))
    at, khz = parameters[: 2 * links], parameters[2 * links : 3 * links]
    gain = ca.reshape(parameters[3 * links : (3 + n_uavs) * links], n_uavs, links)
    server = ca.reshape(parameters[(3 + n_uavs) * links :], n_uavs, links)
    rates = []
    for link in range(links):
        snr = [
            gain[u, link]
            / ((q[2 * u] - at[2 * link]) ** 2 + (q[2 * u + 1] - at[2 * link + 1]) ** 2 + problem.altitude_m[u] ** 2)
            for u in range(n_uavs)
        ]
        received = 1 + sum(snr)
        signal = sum(server[u, link] * snr[u] for u in range(n_uavs))
        rates.append(khz[link] * (ca.log(received) - ca.log(received - signal)) / np.log(2))
    return ca.Function("slot_rates", [q, parameters], [sum(rates) if total else ca.vertcat(*rates)])


def _utility(problem: Problem, rates: Any) -> Any:
    """Return `planner.utility.utility_kbps` of sum rates (1, N), or else of rates (K, N), one link for each user."""
    past, expectation = problem.past_kbps, kind_of(problem.kind).expectation
    if expectation == Expectation.SLOT_SUMS or problem.mu == 0.0:
        return _soft_mean(ca.horzcat(ca.DM(past.sum(axis=0, keepdims=True)), rates), problem.mu)
    if expectation == Expectation.ALL_USERS:
        flat = ca.horzcat(ca.DM(past.reshape(1, -1)), ca.vec(rates).T)
        return problem.n_users * _soft_mean(flat, problem.mu)
    rows = [ca.horzcat(ca.DM(past[k : k + 1]), rates[k, :]) for k in range(problem.n_users)]
    return sum(_soft_mean(row, problem.mu) for row in rows)


def _soft_mean(values: Any, mu: float) -> Any:
    if mu == 0.0:
        return ca.sum2(values) / values.shape[1]
    return (ca.logsumexp(mu * values.T) - np.log(values.shape[1])) / mu
