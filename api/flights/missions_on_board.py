"""The missions that UAVs have on board as far as that is proven, and those that were compiled for them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence

from skyfolio.api.flights.assigned_missions import AssignedMission
from skyfolio.mavlink_bridge import Mission
from skyfolio.mavlink_bridge.verified import OnBoard


class MissionsOnBoard:
    """For each UAV the missions that it may fly: one where that is proven, several while one is sent or if that failed.

    A compiled mission is only on offer. It may be flown once it is being sent, and is the only one once it was read
    back.
    """

    def __init__(self) -> None:
        self._may_fly: dict[str, tuple[AssignedMission, ...]] = {}
        self._offered: dict[str, AssignedMission] = {}

    def offer(self, uav: str, assigned: AssignedMission) -> None:
        """Note a mission that was compiled for this UAV and not sent."""
        self._offered[uav] = assigned

    def offered(self) -> dict[str, AssignedMission]:
        """Return the mission that was compiled last for each UAV."""
        return dict(self._offered)

    def sending(self, uavs: Iterable[str]) -> dict[str, AssignedMission]:
        """Note that the missions on offer for these UAVs are being sent, and return them.

        From now on each may be on board, and so may what was there before.
        """
        sent = {uav: self._offered[uav] for uav in uavs}
        for uav, assigned in sent.items():
            self._may_fly[uav] = (*self._others(uav, assigned.mission), assigned)
        return sent

    def record_on_board(self, uav: str, mission: Mission, on_board: OnBoard) -> None:
        """Note how sending a mission ended: it is on board, what was there before still is, or that is not known."""
        assigned = self.of(uav, mission)
        if assigned is None:
            return
        if on_board is OnBoard.NEW:
            self._may_fly[uav] = (assigned,)
        elif on_board is OnBoard.OLD:
            self._may_fly[uav] = tuple(self._others(uav, mission))

    def restore(self, may_fly: Mapping[str, Sequence[AssignedMission]]) -> None:
        """Take over the missions that each UAV may have on board, the newest first, as a restart finds them stored."""
        self._may_fly = {uav: tuple(reversed(missions)) for uav, missions in may_fly.items()}

    def may_fly(self, uav: str) -> tuple[AssignedMission, ...]:
        """Return the missions that a UAV may fly, the newest last."""
        return self._may_fly.get(uav, ())

    def newest(self) -> dict[str, AssignedMission]:
        """Return for each UAV the newest mission that it may fly."""
        return {uav: missions[-1] for uav, missions in self._may_fly.items() if missions}

    def of(self, uav: str, mission: Mission) -> AssignedMission | None:
        """Return the assigned mission of this UAV with that mission; None if it may not be on board."""
        return next((assigned for assigned in self.may_fly(uav) if assigned.mission is mission), None)

    def _others(self, uav: str, mission: Mission) -> Iterator[AssignedMission]:
        return (assigned for assigned in self.may_fly(uav) if assigned.mission is not mission)
