"""The array type of the whole planner."""

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
"""Of floats; shapes are in docstrings: U UAVs, K users, N slots."""
