"""Plans for fleets that are too large to be planned at once: areas one by one, each with the others as they fly.

What couples areas is interference, which falls with the squared distance, and D_min. So (`search.py`): where everybody
hovers is sketched for the whole fleet, with some of the users (`sketch.py`). Then the fleet is cut into areas of a few
neighbours (`partition.py`), and each area is planned anew by the default method while everybody else flies as before
(`blocks.py`): UAVs next to the area are in its problem with pinned paths, so that it sees what it does to their users;
those further away are noise that differs by user and slot (`noise.py`), which is exact as long as they do not move.
Areas without a UAV in common are planned at the same time, by whatever the caller runs tasks with. A round
over all areas counts only if the joint utility is greater after it (`joint.py`); the next one cuts elsewhere. A replan
gives the places at which something has changed, and only areas around them are planned anew.

No array has U K N entries, and what an area takes does not depend on how many there are. `size.py` says when `plan`
does this by itself.
"""

from skyfolio.planner.areas.search import optimise

__all__ = ["optimise"]
