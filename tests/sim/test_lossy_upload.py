"""A 100-item upload over a radio that loses a tenth of all datagrams each way, in virtual time"""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import pytest

from skyfolio.sim import Fleet, Impairments, VirtualClock, grid_of

if TYPE_CHECKING:
    from tests.sim.conftest import Items, VirtualGcs

HOME = (47.397742, 8.545594)
BAD = Impairments(loss=0.1)
SEEDS = 100


@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_it_succeeds_for_at_least_99_of_100_seeds(
    autopilot: str, items: "Items", virtual_gcs: Callable[[Fleet], "VirtualGcs"]
) -> None:
    mission: list[Any] = [items.waypoint(float(n), 0.0, p1=1.0) for n in range(100)]
    done = 0
    for seed in range(SEEDS):
        fleet = Fleet(grid_of(1, *HOME, autopilot=autopilot), clock=VirtualClock(), seed=seed)
        fleet.impair(up=BAD, down=BAD)
        known = virtual_gcs(fleet).upload(mission)
        true = [item.x for item in fleet.vehicles[1].autopilot.missions.mission.items] == [item[9] for item in mission]
        assert true or not known, "an upload is never believed that is not there"
        done += known
    assert done >= 99
