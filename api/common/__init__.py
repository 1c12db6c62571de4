"""What every room of the service may use; it imports no other room.

    settings, configuration      the settings, and their checks before anything starts
    errors, problem, validation  errors that a client can act on, and the form in which they are reported
    idempotency                  ids of resources that are created once
    supervision, metrics, logs   background tasks that are restarted, Prometheus metrics, structured logs
    fleet_clock, slots           fleet time, slots as text
    extras                       clear errors for optional dependencies that are missing
    kernels                      where the optimiser's compiled code is kept; imported before anything imports numba

Add a module here only when two rooms need it. `errors` and `kernels` are imported by worker processes and by
`import skyfolio`: they stay free of third-party imports. A new setting gets a field, and a sentence in the docstring of
`Settings`.
"""
