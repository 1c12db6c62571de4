"""Experiments with the product: simulated fleets, the demonstration drill, benchmarks, the letter's figures.

    simulate, radio              `skyfolio simulate`, and the true rates of users while a plan is flown
    radio_client                 how base stations of a simulated fleet reach the service that flies it
    demo/                        `skyfolio demo`: a drill whose every claim is checked against the ground truth
    bench/                       `skyfolio bench`: planner, bridge, service, simulator, start
    sweep/                       `skyfolio sweep`: many cases on the workers of a Dask cluster
    reproduce/                   `skyfolio reproduce` and `tune-mu`: the letter's figures and numbers
    plots                        figures by matplotlib, an extra
    virtual_flight, virtual_wire  the bridge against simulated autopilots in virtual time; tests use them too

It is a leaf: it may import the rooms of the service, and only `cli` and tests import it. Numbers in `docs/` come from
here and are never typed by hand: change an experiment, run it, commit its output.
"""
