"""The fast path: the same problem as `reference/`, solved in microseconds by serial numba kernels.

Start at `optimise.py`; its stages are: where to hover (`sketch.py`: which users; `snapshots.py` and `appraisal.py`:
what places are worth; `settling.py`: a local search by that), who goes where (`placement.py`), how to fly there
(`routes.py`, `seeds.py`), and the climb. One pass of a climb (`climb.py`) steers for the links there are
(`ascent.py`: projected gradient; `rates.py`: rates, utility and slope, of few links by `links_narrow.py`, of many by
`links_wide.py`, averaged over draws of the fading by `links_drawn.py`) and links anew at the new paths (`matching.py`:
exact assignment for `sum`; `shares.py`, `exchange.py` and `market.py`: water-filling for the other utilities and
minimum rates, which `floors.py` keeps while UAVs move). Every path goes through `flight.py`, which keeps speed, area,
ends, separation and no-fly zones (`zones.py`) slot by slot. Replans that change little climb with `priced.py` instead
(`tolls.py`: metres off the old paths; `assigning.py` and `trading.py`: users that change UAVs at a toll). The kernels
see an `Arena`, the problem as plain arrays; nothing here keeps state between calls.
"""

from skyfolio.planner.fast.assigning import Tolls
from skyfolio.planner.fast.optimise import default_starts, flyable, linked, optimise
from skyfolio.planner.fast.priced import PricedClimb
from skyfolio.planner.fast.served import as_asked, served_rates_bps

__all__ = ["PricedClimb", "Tolls", "as_asked", "default_starts", "flyable", "linked", "optimise", "served_rates_bps"]
