"""Benchmarks on this machine: `skyfolio bench planner`, `bridge`, `service`, `scale`, `simulator`.

Planner: `cases.py` says what is measured, `measure.py` how; each case runs alone in a process pinned to one core
(`child.py`). `planner.py` starts them and compares, `report.py` turns the figures into tables. `ipopt.py` and
`ablation.py` hold the yardsticks; `quality.py` sets plans beside the best known values (`best_known.py`) and those
of `peers.py`. Bridge: `bridge_virtual.py` in virtual time, `bridge_sockets.py` in real time, on `tracks.py`.
Service: `service.py` from outside, `streams.py` its event streams under load, `loop.py` what holds its event loop.
`scale.py`: sweeps (`scale_sweep.py`, `scale_limits.py`, `scale_faults.py`), how far one service goes
(`scale_service.py`), what many areas need (`many_areas.py`), and their page (`scale_page.py`).
"""

from skyfolio.api.lab.bench.planner import planner_figures
from skyfolio.api.lab.bench.report import markdown, table

__all__ = ["markdown", "planner_figures", "table"]
