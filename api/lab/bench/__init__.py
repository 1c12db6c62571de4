"""Benchmarks on this machine: `skyfolio bench planner`, `bridge`, `service`, `scale`, `simulator`.

Planner: `parts.py` says what there is to measure and `effort.py` how much of it, `planner.py` runs each part alone in a
process pinned to a core (`child.py`) and `figures.py` keeps what came out. The sections: `quality.py` (plans, replans,
budgets and replans that change little, on the instances of `instances.py`), `bounding.py` (what can be proven of them),
`peers.py` (other searches), `cases.py` (the planner and other solvers from the same start, with `ipopt.py` and
`ablation.py`), `checked.py` (the independent check). `shares.py` sets values beside the best known ones
(`best_known.py`), `targets.py` beside what was asked for; `report.py` and `quality_page.py` write the pages.
Bridge: `bridge_virtual.py` in virtual time, `bridge_sockets.py` in real time, on `tracks.py`.
Service: `service.py` from outside, `streams.py` its event streams under load, `loop.py` what holds its event loop.
`scale.py`: sweeps (`scale_sweep.py`, `scale_limits.py`, `scale_faults.py`), how far one service goes
(`scale_service.py`), what many areas need (`many_areas.py`), and their page (`scale_page.py`).
"""
