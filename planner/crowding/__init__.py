"""An upper bound of a slot's weighted sum rate that knows: not all UAVs can be far from each other at once.

Every UAV interferes with every served user, and U of them have to be somewhere in the area. Three steps lead from that
to a number (log is natural, lengths are in units of the greatest altitude H, gains in units of H^2):

1. *Pairs.* A UAV at p serves user k at noise plus interference x. Cut the values of x into intervals; in [x_l, x_h] and
   for any b >= 0, log(1 + S/x) <= a - b x with a the greater of log(1 + S/x) + b x at the two ends (it is convex). So
   the slot is worth at most the sum of (a - b) less b_u times what each other UAV adds at k_u: a sum over pairs.
2. *A positive definite minorant.* Let kappa be positive definite on the plane and kappa(D) <= 1 / (1 + D^2). Let m be
   the middle between p and its user, r their distance, f = s(r) sqrt(2 b g). A pair costs b g' / (1 + |p' - k|^2) +
   b' g / (1 + |p - k'|^2) >= 2 sqrt(b b' g g') / (1 + |m - m'|^2 + ((r + r') / 2)^2) >= f f' kappa(|m - m'|): the first
   step is the inequality of the means, once for the sum and once for the product of the denominators (p' - k and
   k' - p are m' - m plus and minus half the sum of two vectors as long as r and r'); s is such that the second holds.
3. *A field.* With psi the feature map of kappa, the pairs of a fleet cost together at least (|sum f psi(m)|^2 -
   sum f^2 kappa(0)) / 2, and |A|^2 >= 2 <A, F> - |F|^2 for any field F. What is left is linear: the slot is worth at
   most |F|^2 / 2 plus the best assignment of UAVs to users where a pair is worth the greatest a - b + f^2 kappa(0) / 2
   - f F(m) over the intervals of x, and over the distances r that the UAV can have from the user by then.

Any kappa and any F prove something, and so does any choice of b, which is the best one for each interval. Good fields
come from the Frank-Wolfe method over who is served (`field.py`), whose every step is a bound, good kappas from linear
programs over radial functions: `standard.py` for any fleet of a size, `fit.py` for one slot. UAVs that differ in power,
altitude or sampled fading interfere at least as the weakest channel to each user, at the greatest altitude.

`repulsion.py` checks and tabulates a kappa, `columns.py` has the compiled kernels, `slots.py` the arrays of a slot;
`bound.py` is what every plan gets, `proof.py` what `skyfolio bound` does in a minute.
"""
