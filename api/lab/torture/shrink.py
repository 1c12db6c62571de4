"""Makes a failing drill smaller, as long as it breaks the same invariant."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from skyfolio.api.lab.torture.drill import Drill

MOST_TRIES = 60
_SETTINGS = (
    *("gust_mps", "gps_m", "loss", "latency_s", "autopilots", "solve_s", "plan_ahead"),
    *("beside", "guidance", "fall_back", "at_end"),
)
Breaks = Callable[[Drill], bool]
"""Whether a drill breaks what the first one broke."""


def smaller(drill: Drill, breaks: Breaks, most_tries: int = MOST_TRIES) -> Drill:
    """Return the smallest drill found that still breaks: fewer blows first, then a simpler flight."""
    tries = 0
    found = True
    while found:
        found = False
        for candidate in _candidates(drill):
            if tries >= most_tries:
                return drill
            tries += 1
            if breaks(candidate):
                drill, found = candidate, True
                break
    return drill


def _candidates(drill: Drill) -> Iterator[Drill]:
    """Yield drills that are one step simpler."""
    for place in range(len(drill.blows)):
        yield drill.model_copy(update={"blows": drill.blows[:place] + drill.blows[place + 1 :]})
    simple = Drill(seed=drill.seed)
    for name in _SETTINGS:
        if getattr(drill, name) != getattr(simple, name):
            yield drill.model_copy(update={name: getattr(simple, name)})
    if drill.slots > 8:
        yield drill.model_copy(update={"slots": 8})
    for place, blow in enumerate(drill.blows):
        if blow.when.after_s:
            sooner = blow.model_copy(update={"when": blow.when.model_copy(update={"after_s": 0.0})})
            yield drill.model_copy(update={"blows": (*drill.blows[:place], sooner, *drill.blows[place + 1 :])})
