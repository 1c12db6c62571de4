"""`skyfolio sweep`: thousands of scenarios and ways to plan them, on the workers of a Dask cluster.

    spec      what is asked: a base scenario, what is set, what is varied, by a grid or at random
    settings  puts settings into the base: one case
    case      plans one case, and replans it after a loss: one row
    parts     the results: Parquet files of one batch each, named by what was asked
    farm      batches on the workers of a cluster, each result fetched and released at once
    run       all of it, resumed where it was stopped
    results   what is read again: all rows, a summary, plots

Rows are only ever written by the process that runs the sweep, a part at a time, whole or not at all: a worker that dies
takes nothing along but the batch that it was computing.
"""
