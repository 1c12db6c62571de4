"""Plans over ground: how high each UAV flies in each slot, and what its links are worth up there.

A method plans paths as if UAVs kept their height above level ground. Then (`aloft.py`) each path gets altitudes that
keep clear of the ground on its legs and on the ways home from everywhere on them, as climb rates allow (`room.py`);
paths that no altitude can make safe, or whose climbs leave too little energy to come home, are cut short
(`shortening.py`), and planned again with less of it (`thrift.py`). At these places and heights every link has its exact
gain (`links.py`); paths are climbed once more from there, altitudes are chosen between their limits (`choosing.py`,
with what each is worth by `heard.py`), and users are associated anew. What no plan over this ground can exceed is in
`bounding.py`. `skyfolio.planner.clearance` checks what comes out, and shares no code with all this.
"""
