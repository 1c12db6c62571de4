"""sim.field_texts: crew, packs and wind as they are written on a command line"""

from typing import Any

import pytest

from skyfolio.sim import BATTERY_MAH, FieldKnobs, Packs, WindFront, field_from
from skyfolio.sim.airframe import RESERVE_SHARE, Battery, capacity_for_mah, flight_power_w

NOTHING: dict[str, Any] = {"crew": 0, "turnaround_s": 90.0, "packs": "", "battery_minutes": None, "fronts": []}


def test_by_default_nothing_happens_around_a_fleet() -> None:
    assert field_from(**NOTHING) == FieldKnobs()
    assert FieldKnobs().battery_mah == BATTERY_MAH


def test_crew_packs_and_fronts_are_read() -> None:
    field = field_from(
        crew=2,
        turnaround_s=15.0,
        packs="count=3, charge_s=1800",
        battery_minutes=18.0,
        fronts=["at_s=600,east_mps=6", "at_s=60,north_mps=2,ramp_s=5"],
    )
    assert field.crew is not None
    assert (field.crew.members, field.crew.turnaround_s, field.crew.off_s) == (2, 15.0, 10.0)
    assert field.crew.packs == Packs(count=3, charge_s=1800)
    assert field.fronts == (WindFront(at_s=60, north_mps=2, ramp_s=5), WindFront(at_s=600, east_mps=6))
    assert field.battery_mah == pytest.approx(5000.0, rel=0.01)


def test_a_battery_of_so_many_minutes_hovers_for_so_many_minutes() -> None:
    battery = Battery()
    for _ in range(10 * 60):
        battery.drain(flight_power_w(0.0, 0.0), 1.0, capacity_for_mah(10.0))
    assert battery.share == pytest.approx(RESERVE_SHARE)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"packs": "count=3"}, "packs: nobody changes them without a crew"),
        ({"crew": 1, "packs": "colour=red"}, "colour: a pad has no such field, it has charge_s"),
        ({"crew": 1, "packs": "count"}, "'count' must look like FIELD=VALUE"),
        ({"crew": 1, "turnaround_s": 5.0}, "turnaround_s must be at least 10, got 5"),
        ({"fronts": ["east_mps=3"]}, "at_s: a wind front needs it"),
        ({"fronts": ["at_s=3,gust_mps=-1"]}, "gust_mps must be between 0"),
        ({"battery_minutes": 0.5}, "battery_minutes must be between 1"),
    ],
)
def test_what_cannot_be_is_refused(options: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        field_from(**{**NOTHING, **options})
