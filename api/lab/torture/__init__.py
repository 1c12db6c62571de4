"""Drills by the thousand on the virtual ground: seeded blows at the moments that hurt, and what must hold all the same.

    drill        one drill as a small JSON document: scenario, fleet, policy, and blows, each at a moment
    generator    draws a drill from a seed
    aims         what every second drill is after: faults that have to come together, in the states in which they hurt
    triggers     strikes at a moment: before or after a journal step, at a state, or so long after the start
    blows        what strikes: vehicles, the service, its disk, its workers and clock, and the operator's commands
    watch        what is seen meanwhile, ground truth included, as `sightings`
    invariants   what must hold, each a function with its reason: of the vehicles, and in `losses` of who is lost, in
                 `recoveries` of what is done about it, in `guiding` of slips and orders, in `records` of what is
                 written, in `reserved_air` of ghosts; `checks` says when
    flight       flies one drill and returns what was broken
    shrink       makes a failing drill smaller, as long as it breaks the same
    campaign     many drills, on several cores, with the coverage of states and blows
    mutations    planted bugs, and whether drills find them; `hunter` flies drills with the copy that has one

A new invariant is a function with `@meanwhile`, `@at_end` or `@afterwards`, and a history that breaks it in
`tests/api/test_invariants.py`; a new blow is an entry of `blows.BLOWS`
and one of the generator's kinds. Everything is decided by the drill: the same file breaks the same every time.
"""
