"""Drills by the thousand on the virtual ground: seeded blows at the moments that hurt, and what must hold all the same.

    drill        one drill as a small JSON document: scenario, fleet, policy, and blows, each at a moment
    generator    draws a drill from a seed
    triggers     strikes at a moment: before or after a journal step, at a state, or so long after the start
    blows        what strikes: vehicles, the service, its disk, its workers and clock, and the operator's commands
    watch        what is seen meanwhile, ground truth included
    invariants   what must hold, each a function with its reason
    flight       flies one drill and returns what was broken
    shrink       makes a failing drill smaller, as long as it breaks the same
    campaign     many drills, on several cores, with the coverage of states and blows

A new invariant is a function with `@at_end` or `@meanwhile` in `invariants`; a new blow is an entry of `blows.BLOWS`
and one of the generator's kinds. Everything is decided by the drill: the same file breaks the same every time.
"""
