"""The service: holds the optimiser, flies its plans with a fleet, and closes the loop when an aircraft is lost.

`app.py` puts the parts together; `routes/` parse, call and render; `plan_book.py` and `solver.py` own the plans and
the worker processes; `fleet.py`, `operations.py` and `resilience.py` fly; `cli.py` is the `skyfolio` command and
`demo/` the drill that it shows. Errors leave through one table, `problems.py`.
"""

from importlib.metadata import version

__version__ = version("skyfolio")
