"""Wind and energy: what a UAV can fly against the air, what that costs it, and whether it comes home.

`parts.py` has the fields of a scenario, `power.py` the law of a rotary wing, `air.py` what a whole fleet can fly and
spends, `fit.py` the constants of a vehicle from what it reports in flight. `feasibility_air.py`, beside the independent
checker, shares none of it.
"""
