"""The service: holds the optimiser, flies its plans with a fleet, and closes the loop when an aircraft is lost.

    routes/ <- gate (keys, limits, audit)           parse, call, render; errors leave through `problems`
    plan_book, solver -> solving, contingencies     plans, worker processes, plans made ahead of a loss
    fleet, take_off, flight, operation(s)           vehicles, the way into slot 0, one flight, operations
    guidance, streaming, given                      keepers or a stream, its guard, what each vehicle was given
    incidents, resilience, swapping, transition     what happens in flight and how it is answered
    journal, reattach, store/, events               what is kept, and how a restart goes on with it
    client, cli, remote_cli, keys_cli               ways in; `demo/` is the drill, `bench/` what measures all of this

`service.py` puts the parts together, `app.py` the routes. A step that reaches a vehicle is in the journal before it is
sent: whoever adds one keeps to that, and adds it to the kill matrix in the tests.
"""

from importlib.metadata import version

__version__ = version("skyfolio")
