"""The letter as printed: Algorithm 1 and its subproblems in cvxpy, solved by Clarabel.

This is documentation that runs. It is slow, reads beside the letter equation by equation, and is the oracle that the
fast path is tested against. Start at `algorithm1.py`.
"""

from skyfolio.planner.reference.algorithm1 import algorithm_1

__all__ = ["algorithm_1"]
