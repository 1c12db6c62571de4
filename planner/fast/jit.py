"""How kernels are compiled: serial, without the GIL, cached on disk."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

from numba import njit

_OPTIONS = {"cache": True, "nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
_LOOSE = {"nnan", "reassoc", "contract", "nsz", "arcp"}
Function = TypeVar("Function", bound=Callable[..., Any])


def entry(function: Function) -> Function:
    """Compile a kernel that Python calls: serial, without the GIL, cached on disk.

    Arguments are made new or pass through `plain`. numba looks only at a function's own file to see whether what is
    cached is still right, and not at the kernels that it calls: `api.common.kernels` keeps a cache for each version
    of all sources, and who uses the planner alone deletes the caches (`make clean`) after editing a kernel.
    """
    return cast("Function", njit(**_OPTIONS)(function))


def kernel(function: Function) -> Function:
    """Return the same for kernels that only kernels call."""
    return cast("Function", njit(**_OPTIONS, no_cpython_wrapper=True)(function))


def smooth(function: Function) -> Function:
    """As `kernel`, and sums may be added up in any fixed order, eight at a time."""
    return cast("Function", njit(**_OPTIONS, no_cpython_wrapper=True, fastmath=_LOOSE)(function))


def inlined(function: Function) -> Function:
    """As `kernel`, always put in place of its call, so that the loop that calls it can be vectorised."""
    return cast("Function", njit(**_OPTIONS, no_cpython_wrapper=True, forceinline=True)(function))
