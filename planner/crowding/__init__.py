"""An upper bound of a slot's weighted sum rate that knows: not all UAVs can be far from each other at once.

Every UAV interferes with every served user, and U of them have to be somewhere. Three steps lead from that to a number
that only depends on where the users are (log is natural, lengths are in units of the greatest altitude H, gains in
units of H^2; h is a UAV's own altitude):

1. *Pairs.* A UAV at distance r from its user k, who receives noise plus interference x, serves k with log(1 + S/y):
   S = G / (h^2 + q^2), y = x (h^2 + r^2) / (h^2 + q^2), and q <= r is the least distance that it can have by then. Cut
   the values of y into intervals; in [y_l, y_h] and for any b >= 0, log(1 + S/y) <= a - b y with a the greater of
   log(1 + S/y) + b y at the two ends (it is convex). As (h^2 + r^2) / (h^2 + q^2) >= (1 + r^2) / (1 + q^2) >= 1, the
   slot is worth at most the sum of (a - b), less b g' (1 + r^2) / ((1 + q^2) (1 + |p' - k|^2)) for each other UAV: one
   that is at p' and reaches k with the gain g' at least. That is a sum over pairs.
2. *A positive definite minorant.* Let D be the distance of two served users. What a pair costs is at least twice the
   root of the product of its two terms. With |p' - k| <= D + r' and |p - k'| <= D + r the product separates, and a UAV
   contributes (1 + r^2) / (1 + (D + r)^2) >= 1 / psi_q(D), the least over r >= q: wherever it is. With q = 0 that is
   phi(D) = exp(2 asinh(D / 2)), little more than the 1 + D^2 of UAVs right above their users: so much can be gained by
   hovering elsewhere. Let kappa be positive definite on the plane and kappa <= 1 / phi. A pair costs at least
   f f' kappa(D), with f = s_q sqrt(2 b g) and s_q^2 the least of 1 / (kappa(D) (1 + q^2) psi_q(D)) over all D.
3. *A field.* With chi the feature map of kappa, the pairs of a fleet cost together at least (|sum f chi(k)|^2 -
   sum f^2 kappa(0)) / 2, and |A|^2 >= 2 <A, F> - |F|^2 for any field F. What is left is linear: the slot is worth at
   most |F|^2 / 2 plus the best assignment of UAVs to users where a pair is worth the greatest a - b + f^2 kappa(0) / 2
   - f F(k) over the intervals of y.

Any kappa and any F prove something, and so does any choice of b, which is the best one for each interval. Good fields
come from the Frank-Wolfe method over who is served (`field.py`), whose every step is a bound, good kappas from linear
programs over radial functions (`fit.py`): for one slot, or once for users that crowd as much (`standard.py`). UAVs that
differ in power, altitude or sampled fading interfere at least as the weakest channel to each user, at the greatest
altitude.

`repulsion.py` checks and tabulates a kappa, `columns.py` has the compiled kernels, `slots.py` the arrays of a slot;
`bound.py` is what every plan gets, `proof.py` what `skyfolio bound` does in a minute.
"""
