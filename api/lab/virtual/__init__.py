"""A whole service and its fleet in one process and in virtual time: no sockets, threads or processes of their own.

    loop       an event loop whose time jumps to the next timer
    codec      MAVLink 2 frames of messages, and back
    wire       the link: a memory endpoint to `sim.Fleet`, and a port that speaks through `codec`
    disk       SQLite in memory that outlives a service, slow or full on demand
    leases     what services that share the disk see of their leases
    solving    solves at once, delivered after as long as a worker would have taken
    guards     what speaks for a service that died while it streamed
    running    what belongs to one service alone: its tasks, its port, its ways to the disk, its guards
    ground     the service on all this, with a fleet: started, killed, and started again

The service is the real one, made by its composition root (`api.service.Ports`); it does not know this folder. The same
seed gives the same event log byte for byte. `api.lab.torture` flies drills on this ground.
"""
