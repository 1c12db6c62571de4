"""The service: holds the optimiser, flies its plans with a fleet, and closes the loop when an aircraft is lost.

    routes/ <- gate (keys, limits, audit)           parse, call, render; errors leave through `problems`
    origins, headers, attempts, connections, proxies who is let in, and what a browser may do with a page
    plan_book, solver -> worker, solving            plans, and the processes that make them
    contingencies                                   plans made ahead of a loss
    fleet, fleet_news, take_off                     vehicles, what is heard of them, the way into slot 0
    flight, operation(s)                            one flight, operations
    commander, orders, aborts                       emergency orders, which wait for nobody and go before everything
    skies, transition                               air of all operations, and the ways between two plans
    guidance, streaming, given, aboard              keepers or a stream, its guard, what each vehicle was given and has
    roster, own_link, losses                        who counts, and whether it is our own link that is silent
    incidents, resilience, swapping                 what happens in flight and how it is answered
    ends, stragglers                                how each UAV ended, and who is brought down
    flown_rates, track                              what users got, kept as it is flown
    journal, reattach, store/, events, retention    what is kept and for how long, and how a restart goes on with it
    supervise, liveness                             background tasks and workers that are watched
    client, cli, remote_cli, keys_cli, check        ways in; `demo/` is the drill, `bench/` what measures all of this
    kernels                                         where the optimiser's compiled code is kept

`service.py` puts the parts together, `app.py` the routes. A step that reaches a vehicle is in the journal before it is
sent: whoever adds one keeps to that, and adds it to the kill matrix in the tests.
"""
