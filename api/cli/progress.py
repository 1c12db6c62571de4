"""What is written to standard error while something is planned or proven: only on a terminal, and gone in the end."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from skyfolio.planner import AnyOf, Iteration, Scenario


@contextmanager
def planning(scenario: Scenario, stop: AnyOf) -> Iterator[dict[str, Any]]:
    """Return options of `plan`: areas of a large fleet use all cores, and a terminal shows the best plan so far."""
    from skyfolio.api.plans.area_threads import AreaThreads, interrupting  # noqa: PLC0415 - loads the solver
    from skyfolio.planner.areas.size import is_large  # noqa: PLC0415

    console = Console(stderr=True)
    columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    by_areas = is_large(scenario)
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        row = bar.add_task("planning by areas: looking for places" if by_areas else "planning")
        iterations, pieces, best_bps = 0, 0, None

        def show() -> None:
            done = f"by areas: {pieces} pieces of work done" if by_areas else f"iteration {iterations}"
            worth = "" if best_bps is None else f", best so far {best_bps / 1e3:.2f} kbit/s"
            bar.update(row, description=f"planning, {done}{worth}")

        def observer(iteration: Iteration) -> None:
            nonlocal iterations, best_bps
            iterations += 1
            best_bps = iteration.utility_bps if best_bps is None else max(best_bps, iteration.utility_bps)
            show()

        def told(tasks: int) -> None:
            nonlocal pieces
            pieces = tasks
            show()

        with AreaThreads(interrupting(stop), told=told) as run_areas:
            yield {"run_areas": run_areas, "observer": observer}


@contextmanager
def proving(seconds: float) -> Iterator[Callable[[float, float], None]]:
    """Return a bar on standard error: how much of the time is gone, and what is proven by then."""
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("planning", total=seconds)
        yield lambda gone_s, bound_bps: bar.update(
            task, completed=min(gone_s, seconds), description=f"at most {bound_bps / 1e3:.2f} kbit/s"
        )
