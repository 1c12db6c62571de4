"""What can become of a field of a mission item that an autopilot stores: the vocabulary of `AutopilotProfile.kept`.

Storage is smaller than a MISSION_ITEM_INT, so a sound mission does not come back literally. Each field has a rule: it
comes back as it was sent (`SAME`), changed in a known way (`WHOLE`, `DEGREES`, ...), as 0 whatever was sent
(`DROPPED`), or its value means nothing (`ANY`). A command without a row has to come back literally.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import fmod, isclose, isnan, trunc

_REL = 2.0**-22
"""Two units in the last place of a float32."""
_ABS = 1e-6


@dataclass(frozen=True, slots=True)
class Rule:
    """What is kept of one value: `kept(sent)`, within a tolerance, or around `full_turn`. None: any value will do."""

    kept: Callable[[float], float] | None
    within: float = _ABS
    full_turn: float | None = None

    def allows(self, sent: float, read: float) -> bool:
        """Return whether `read` is what the vehicle makes of `sent`."""
        if self.kept is None:
            return True
        expected = self.kept(sent)
        if isnan(expected) or isnan(read):
            return isnan(expected) and isnan(read)
        if self.full_turn is not None:
            apart = abs(fmod(expected - read, self.full_turn))
            return min(apart, self.full_turn - apart) <= self.within
        return isclose(expected, read, rel_tol=_REL, abs_tol=self.within)


def _whole(sent: float) -> float:
    return sent if isnan(sent) else float(trunc(sent))


def _direction(sent: float) -> float:
    """Return the sign, which is all that is kept; nothing is clockwise."""
    return -1.0 if sent < 0.0 else 1.0


SAME = Rule(lambda sent: sent)
DROPPED = Rule(lambda _sent: 0.0)
SET = Rule(lambda _sent: 1.0)
ANY = Rule(None)
WHOLE = Rule(_whole)
"""Cut off to an integer."""
NEAREST = Rule(lambda sent: float(trunc(sent + 0.5)))
FLAG = Rule(lambda sent: 1.0 if sent > 0.0 else 0.0)
DIRECTION = Rule(_direction)
DEGREES = Rule(lambda sent: sent, within=1e-3, full_turn=360.0)
"""Stored in radians from 0 to a full turn."""
CENTIMETRES = Rule(lambda sent: sent, within=0.0101)
"""Cut off to a centimetre, after a multiplication in float32 that may end just below one."""
MILLIMETRES = Rule(lambda sent: sent, within=1.01e-3)
"""Stored as an integer where less than a thousandth is lost."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Kept:
    """What is kept of an item. `placed`: latitude and longitude are; `datum`: what its altitude is measured from is."""

    param1: Rule = SAME
    param2: Rule = SAME
    param3: Rule = SAME
    param4: Rule = SAME
    z: Rule = SAME
    autocontinue: Rule = SAME
    placed: bool = True
    datum: bool = True


LITERALLY = Kept()
NO_PARAMS = Kept(param1=DROPPED, param2=DROPPED, param3=DROPPED, param4=DROPPED)
