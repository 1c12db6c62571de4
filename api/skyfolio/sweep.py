"""Results of `skyfolio sweep` in Python: `skyfolio.sweep.load("out/sweep/study")`."""

from skyfolio.api.lab.sweep.results import load

__all__ = ["load"]
