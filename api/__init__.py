"""The service around the planner: it plans on request, flies plans with a fleet, and recovers when a UAV is lost.

    http/       routes, middleware, responses           access/     API keys, wrong-key limits, audit log
    plans/      plans as resources, worker processes    flights/    operations: from take-off over recovery to landing
    fleet/      vehicles, what is heard of them         store/      database, writer, event log, retention
    common/     settings, errors, metrics, clocks       service.py  puts these parts together
    client/     the typed client                        cli/        the `skyfolio` command
    dashboard/  the pages at `/ui`                      lab/        simulation, drill, benchmarks, reproduction
    skyfolio/   what `import skyfolio` itself gives

Which room may import which is in `tests/test_floors.py` (`ROOMS`): `common` imports none, `dashboard` sees the service
as a client does, and no room of the service knows `lab`. Each room's docstring tells what lives there and what may be
touched. A step that reaches a vehicle is in the journal before it is sent: a change that adds one keeps to that, and
adds it to the kill matrix in the tests.
"""
