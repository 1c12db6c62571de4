"""How much of what a UAV sends arrives at a user: a port, and one file for each kind of channel that fills it.

`radio.py` is the port, which has what all kinds share: noise, fading, corrections, and the patterns of antennas
(`antennas.py`). `rician.py` is the letter's, `los_probability.py` and `aerial_3gpp.py` are others, which know line of
sight (`sight.py`); `kinds.py` has their names. Optimisers see a channel as tables over the distance over ground
(`bends.py`), beside the letter's inverse square, which has none. `gain_map.py` depends on more than distances: on where
a UAV is, for each of some receivers; optimisers see that as tables over its place (`excess.py`). To add one:
docs/channels.md.
"""
