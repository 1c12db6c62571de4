"""The error of a method that there is not, or that cannot plan what is asked of it. Loads no optimiser."""

from __future__ import annotations


class UnsuitedError(ValueError):
    """There is no such method, or it does not know a field of the scenario or of the call, which the message names."""
