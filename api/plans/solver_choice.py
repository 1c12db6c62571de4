"""Which solver a service has, as its settings say."""

from __future__ import annotations

from skyfolio.api.common.settings import Settings
from skyfolio.api.plans.dask_lane import solver_with
from skyfolio.api.plans.dask_link import DaskLink
from skyfolio.api.plans.solver import Lane, Solver, solver_of_processes


def solver_for(settings: Settings, flight: Lane | None = None) -> Solver:
    """Return the lanes that the settings ask for: with processes of this machine, or with the workers of a cluster.

    flight: the lane of flights, if it was started before the rest of the service was imported.
    """
    if settings.scheduler is None:
        return solver_of_processes(settings.workers, settings.queue_limit, flight)
    return solver_with(DaskLink(settings.scheduler), settings.workers, settings.queue_limit, flight)
