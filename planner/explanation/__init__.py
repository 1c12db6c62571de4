"""Reasons of a finished plan: why users get little, what one thing more would be worth, and which constraint binds.

Start at `explain.py`. `findings.py` holds the models; they load no solver. `ledger.py` is the plan as arrays, with the
worth of each rate and of each hertz. `ladder.py` says why a user gets little, step by step from what it gets to what
a UAV overhead would give it. `prices.py` has derivatives, `what_if.py` the changed scenarios, `resolving.py` solves
some of them within a budget. `comparison.py` sets two plans side by side.

Every number says how it was obtained: `bound` (it cannot be more), `resolve` (a changed scenario was planned from the
plan's own paths) or `derivative` (the first order at the plan, with all other choices kept).
"""
