"""Benchmarks of the planner, on this machine, against its own reference path and against IPOPT.

`cases.py` says what is measured, `measure.py` how; each case runs alone in a process pinned to one core (`child.py`).
`planner.py` starts them and compares, `report.py` turns the figures into tables. `ipopt.py` and `ablation.py` hold the
yardsticks.
"""

from api.bench.planner import planner_figures
from api.bench.report import markdown, table

__all__ = ["markdown", "planner_figures", "table"]
