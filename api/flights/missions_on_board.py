"""What UAVs have on board, as far as it is proven, beside what was compiled for them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence

from skyfolio.api.flights.assigned_missions import AssignedMission
from skyfolio.mavlink_bridge import Mission
from skyfolio.mavlink_bridge.verified import OnBoard


class MissionsOnBoard:
    """For each UAV the missions it may fly. One, where it is proven; several while one is sent, or after that failed.

    A compiled mission is on offer only: it becomes one that may be flown when it is sent, and the only one when it
    was read back.
    """

    def __init__(self) -> None:
        self._may_fly: dict[str, tuple[AssignedMission, ...]] = {}
        self._offered: dict[str, AssignedMission] = {}

    def offer(self, uav: str, given: AssignedMission) -> None:
        """It was compiled for this UAV and not sent."""
        self._offered[uav] = given

    def offered(self) -> dict[str, AssignedMission]:
        """What was compiled last for each."""
        return dict(self._offered)

    def sending(self, uavs: Iterable[str]) -> dict[str, AssignedMission]:
        """What is on offer for these is sent from now on: it may be on board, and so may what was there before."""
        sent = {uav: self._offered[uav] for uav in uavs}
        for uav, given in sent.items():
            self._may_fly[uav] = (*self._others(uav, given.mission), given)
        return sent

    def record_on_board(self, uav: str, mission: Mission, on_board: OnBoard) -> None:
        """How sending it ended: it is on board, what was there before still is, or that is not known."""
        given = self.of(uav, mission)
        if given is None:
            return
        if on_board is OnBoard.NEW:
            self._may_fly[uav] = (given,)
        elif on_board is OnBoard.OLD:
            self._may_fly[uav] = tuple(self._others(uav, mission))

    def restore(self, may_fly: Mapping[str, Sequence[AssignedMission]]) -> None:
        """Each may have any of these, the newest first: a restart knows no more until they are read back."""
        self._may_fly = {uav: tuple(reversed(given)) for uav, given in may_fly.items()}

    def may_fly(self, uav: str) -> tuple[AssignedMission, ...]:
        """What it may fly, the newest last."""
        return self._may_fly.get(uav, ())

    def newest(self) -> dict[str, AssignedMission]:
        """For each UAV the newest that it may fly."""
        return {uav: given[-1] for uav, given in self._may_fly.items() if given}

    def of(self, uav: str, mission: Mission) -> AssignedMission | None:
        """The one with this mission among those that this UAV may fly."""
        return next((given for given in self.may_fly(uav) if given.mission is mission), None)

    def _others(self, uav: str, mission: Mission) -> Iterator[AssignedMission]:
        return (given for given in self.may_fly(uav) if given.mission is not mission)
