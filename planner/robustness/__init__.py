"""How a plan stands up to what it does not know: fading, wind, errors of position, and losses.

    trial         what is asked: disturbances, losses, what counts as an outage
    disturbances  what is drawn: fading of every pair and slot, wind, errors of position
    flown         where each UAV flies and which users it serves: as planned, and after a loss
    losses        every single and double loss, replanned
    findings      the result
    tallies       percentiles and outages of many draws
    assess        all of it: `assess()`

A draw depends on the seed and its own number alone, and all losses see the same draws, so that they can be compared.
"""
