"""How a plan stands up to what it does not know: fading, wind, errors of position, and losses.

    disturbances  what is drawn: fading of every pair and slot, wind, errors of position
    flown         who flies where and serves whom, as planned, and after losses with a replan and without one
    findings      the result
    tallies       percentiles and outages of many draws
    assess        all of it: `assess()`

A draw depends on the seed and its own number alone, and all losses see the same draws, so that they can be compared.
"""
