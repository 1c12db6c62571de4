"""The exponential and the logarithm, in so few operations that a loop over users computes eight of them at a time.

Calls of the C library's would keep such loops from being vectorised: they are most of what a utility of many users
costs. Both are Cephes' and FreeBSD's well-known approximations (a rational function of the rest after a power of two
is taken out), good to a few units in the last place, and the same on every machine. They only take what occurs here:
no NaN, no infinities but those named. Who calls them may let LLVM add up in any order, and that goes for what is here
too: nothing relies on what a sum is rounded to.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir
from numba import float64, int64
from numba.extending import intrinsic

from skyfolio.planner.fast.jit import inlined

PER_LN2 = 1.4426950408889634074
LN2_HIGH, LN2_LOW = 6.93145751953125e-1, 1.42860682030941723212e-6
"""The logarithm of 2 in two parts: whole multiples of the first are exact."""
SMALLEST, GREATEST = -708.0, 709.0
"""Arguments of `exp` are taken into these limits: what is smaller comes to 3e-308."""
WHOLE = 6755399441055744.0
"""1.5 x 2^52: a whole number that is added to it stands in its last bits."""
ROOT_HALF_BITS = 0x3FE6A09E667F3BCD
"""Of sqrt(1/2): the part of a logarithm's argument beside the power of two lies between this and sqrt(2)."""


def _as_bits(_context: Any, _number: Any) -> Any:
    return int64(float64), lambda _c, builder, _s, arguments: builder.bitcast(arguments[0], ir.IntType(64))


def _as_float(_context: Any, _bits_of_it: Any) -> Any:
    return float64(int64), lambda _c, builder, _s, arguments: builder.bitcast(arguments[0], ir.DoubleType())


_bits: Callable[[float], int] = intrinsic(_as_bits)
"""The 64 bits of a float as an integer."""
_float: Callable[[int], float] = intrinsic(_as_float)
"""The float with these 64 bits."""


@inlined
def exp(x: float) -> float:
    """Return e to the x."""
    x = min(max(x, SMALLEST), GREATEST)
    doublings = np.floor(x * PER_LN2 + 0.5)
    rest = x - doublings * LN2_HIGH - doublings * LN2_LOW
    square = rest * rest
    odd = rest * ((1.26177193074810590878e-4 * square + 3.02994407707441961300e-2) * square + 1.0)
    even = ((3.00198505138664455042e-6 * square + 2.52448340349684104192e-3) * square + 2.27265548208155028766e-1) * (
        square
    ) + 2.0
    power = 1.0 + 2.0 * odd / (even - odd)
    return _float(_bits(power) + (_bits(doublings + WHOLE) << 52))


@inlined
def log(x: float) -> float:
    """Return the natural logarithm of x > 0, of infinity a number above 709; below 2e-308 it is not to be used."""
    bits = _bits(x)
    doublings = (bits - ROOT_HALF_BITS) >> 52
    rest = _float(bits - (doublings << 52)) - 1.0
    power = float(doublings)
    s = rest / (2.0 + rest)
    z = s * s
    w = z * z
    first = w * (3.999999999940941908e-01 + w * (2.222219843214978396e-01 + w * 1.531383769920937332e-01))
    second = z * (
        6.666666666666735130e-01
        + w * (2.857142874366239149e-01 + w * (1.818357216161805012e-01 + w * 1.479819860511658591e-01))
    )
    half = 0.5 * rest * rest
    return power * LN2_HIGH - ((half - (s * (half + first + second) + power * LN2_LOW)) - rest)
