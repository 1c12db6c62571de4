"""Relief: stations that stay manned for as long as the pool of vehicles lasts, on batteries that do not.

`shifts.py` has what a rota is made from and made of, `stays.py` how long a vehicle can stay where, `solver.py` who
relieves whom and when, `bound.py` how many vehicles that takes at least, `check.py` the independent check of a rota.
`relief.py` makes one relief of a plan: changes and pins of a replan, with ways from `crossing.py`.
"""
