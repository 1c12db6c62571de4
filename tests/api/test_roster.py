"""What a roster makes of verdicts that turn out wrong, and of what vehicles warn of."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import Any, cast

import pytest

from skyfolio.api.fleet.commander import Commander, Link
from skyfolio.api.fleet.own_link import Heard, OwnLink
from skyfolio.api.fleet.registry import Fleet
from skyfolio.api.flights.guidance import FlightGuidance
from skyfolio.api.flights.roster import Roster
from skyfolio.mavlink_bridge import FlightMode, LinkEvent
from skyfolio.mavlink_bridge.conditions import Change, Condition
from skyfolio.planner import Origin


class Sky:
    """Two vehicles and what is known of them, as a fleet and a guidance tell it."""

    def __init__(self) -> None:
        self.conditions: dict[int, Change] = {}
        self.silent_s = {1: 0.1, 2: 0.1}
        self.told: dict[int, dict[str, Any]] = {system: {"armed": True, "relative_alt_m": 60.0} for system in (1, 2)}
        self.warnings: dict[int, str] = {}
        self.aloft: set[int] = set()
        self.flown_by: dict[int, str] = {}
        self.notes: list[tuple[str, dict[str, Any]]] = []
        self.reserved: set[str] = set()
        self.slots_s = 30.0
        self.lacks: dict[str, str] = {}
        orders = dict.fromkeys(("hold", "land", "return_home"), self._return_home)
        self.link = SimpleNamespace(telemetry=self._telemetry, **orders)
        self.commander = Commander(lambda: cast("Link", self.link))
        self.airspace = SimpleNamespace(seen=lambda _uav, _at_m: None)
        self.roster = Roster(
            {"a": 1, "b": 2},
            Origin(lat_deg=47.0, lon_deg=8.0),
            cast("Fleet", self),
            cast("FlightGuidance", self),
            now_s=lambda: self.slots_s,
            last_slot_s=lambda _uav: 95.0,
            slot_s=5.0,
            lacking=self.lacks.get,
        )

    def see(self, system_id: int, after: Condition, cause: str = "seen so") -> None:
        self.conditions[system_id] = Change(
            system_id=system_id, before=Condition.LIVE, after=after, cause=cause, at_s=30.0
        )

    def look(self) -> dict[str, str]:
        lost = self.roster.newly_lost(cast("asyncio.Queue[LinkEvent]", asyncio.Queue()))
        return {uav: loss.kind for uav, loss in lost.items()}

    # what a fleet tells

    def condition(self, system_id: int) -> Change | None:
        return self.conditions.get(system_id)

    def heard(self) -> dict[int, Heard]:
        return {system: Heard(silent_for_s=silent, lost=silent >= 5.0) for system, silent in self.silent_s.items()}

    def own_link(self) -> OwnLink:
        return OwnLink(stale_after_s=3.0, lost_after_s=5.0)

    def now_s(self) -> float:
        return 30.0

    def is_aloft(self, system_id: int) -> bool:
        return system_id in self.aloft

    def is_down(self, system_id: int) -> bool:
        return not self.told[system_id]["armed"] and system_id not in self.aloft

    def warning(self, system_id: int) -> str | None:
        return self.warnings.get(system_id)

    def taken(self, system_id: int) -> str | None:
        return self.flown_by.get(system_id)

    def note(self, kind: str, **data: Any) -> None:
        self.notes.append((kind, data))

    def _telemetry(self, system_id: int) -> SimpleNamespace:
        return SimpleNamespace(**{"place_deg": (47.0, 8.0), "mode": FlightMode.LAND} | self.told[system_id])

    async def _return_home(self, system_ids: list[int]) -> dict[int, SimpleNamespace]:
        return {system_id: SimpleNamespace(error=None) for system_id in system_ids}

    # what guidance is told

    def leave(self, uav: str, *, setpoints_too: bool) -> None:
        del uav, setpoints_too

    def reserve(self, uav: str, _where: object) -> None:
        self.reserved.add(uav)

    def release_air(self, uav: str) -> bool:
        was = uav in self.reserved
        self.reserved.discard(uav)
        return was


def test_a_crash_that_is_taken_back_reserves_the_air_again_and_offers_the_uav() -> None:
    sky = Sky()
    sky.see(1, Condition.CRASHED, "sinking at 9.0 m/s at 40.0 m above home")
    assert sky.look() == {"a": "crashed"}
    assert sky.reserved == set()
    sky.see(1, Condition.LIVE, "heard 0.1 s ago, in mode 'mission'")
    assert sky.look() == {}
    assert (sky.roster.returned, sky.reserved, set(sky.roster.lost)) == ({"a"}, {"a"}, {"a"})
    ((kind, data),) = sky.notes
    assert (kind, data["uav_id"], data["verdict"]) == ("verdict_withdrawn", "a", "crashed")
    assert data["because"] == "armed at 60.0 m above home, heard 0.1 s ago, in mode 'mission'"
    assert sky.look() == {}
    assert len(sky.notes) == 1  # told once
    sky.roster.readmit("a")
    assert sky.roster.lost == {}


def test_a_crash_that_is_seen_again_is_no_offer_any_more() -> None:
    sky = Sky()
    for after in (Condition.CRASHED, Condition.LIVE, Condition.CRASHED):
        sky.see(1, after)
        sky.look()
    assert (sky.roster.returned, sky.reserved) == (set(), set())


def test_who_is_down_is_not_offered_because_it_is_only_heard() -> None:
    sky = Sky()
    sky.see(1, Condition.CRASHED)
    sky.look()
    sky.told[1] = {"armed": False, "relative_alt_m": 0.0}
    sky.see(1, Condition.LIVE)
    sky.look()
    assert (sky.roster.returned, sky.reserved) == (set(), set())


def test_who_was_seen_down_and_is_then_flown_by_a_human_has_its_air_again() -> None:
    sky = Sky()
    sky.see(1, Condition.LANDED)
    assert sky.look() == {"a": "landed"}
    sky.see(1, Condition.HUMAN)
    assert sky.look() == {}
    assert sky.roster.losses["a"].kind == "human_took_over"
    assert sky.reserved == {"a"}


def test_contradictory_evidence_is_a_loss_whose_air_stays_reserved_and_which_is_not_down() -> None:
    sky = Sky()
    sky.told[1], sky.aloft = {"armed": False, "relative_alt_m": 60.0}, {1}
    sky.see(1, Condition.DISARMED)
    assert sky.look() == {"a": "disarmed_in_air"}
    assert sky.reserved == {"a"}
    assert not sky.roster.is_down("a")
    assert not sky.roster.has_news  # a new loss is stored with its incident
    sky.see(1, Condition.CRASHED)
    assert sky.look() == {}
    assert sky.roster.has_news


def test_while_nobody_is_heard_losses_by_other_evidence_stay() -> None:
    sky = Sky()
    sky.see(1, Condition.CRASHED)
    assert sky.look() == {"a": "crashed"}
    sky.silent_s = {1: 20.0, 2: 20.0}
    assert sky.look() == {}
    assert sky.roster.own_link.is_lost
    assert set(sky.roster.lost) == {"a"}
    sky.silent_s = {1: 0.1, 2: 0.1}
    assert sky.look() == {}
    assert not sky.roster.own_link.is_lost


def test_what_a_vehicle_warns_of_is_told_once_until_it_changes() -> None:
    sky = Sky()
    sky.warnings[2] = "in mode 'mission', system status 5, said 'GCS Failsafe - Continuing Auto Mode'"
    assert sky.look() == sky.look() == {}
    assert sky.notes == [("uav_warning", {"uav_id": "b", "detail": sky.warnings[2]})]
    del sky.warnings[2]
    sky.look()
    sky.warnings[2] = "again"
    sky.look()
    assert [data["detail"] for _, data in sky.notes][1:] == ["again"]


@pytest.mark.parametrize(("at_s", "flown"), [(94.0, False), (96.0, True)])
def test_who_is_taken_over_once_its_last_slot_has_begun_has_flown_its_plan(at_s: float, flown: bool) -> None:
    sky = Sky()
    sky.slots_s = at_s
    sky.see(1, Condition.HUMAN)
    assert sky.look() == {"a": "human_took_over"}
    assert not sky.roster.may_command("a")
    sky.see(1, Condition.LANDED)
    sky.look()
    assert (sky.roster.left_its_plan("a") is None) is flown


def test_who_is_found_on_the_ground_in_a_mission_that_is_not_over_has_crashed_and_that_stays_so() -> None:
    sky = Sky()
    sky.told[1] = {"armed": False, "relative_alt_m": 0.0, "mode": FlightMode.MISSION}
    sky.see(1, Condition.LANDED)
    assert sky.look() == {"a": "crashed"}
    sky.told[1]["mode"], sky.slots_s = FlightMode.HOLD, 99.0
    assert sky.look() == {}
    loss = sky.roster.left_its_plan("a")
    assert loss is not None
    assert loss.kind == "crashed"
    sky.told[2] = sky.told[1] | {"mode": FlightMode.MISSION}
    sky.see(2, Condition.LANDED)
    assert sky.look() == {}  # the plan is over: it has landed as its mission has it


def test_who_falls_after_the_last_slot_has_not_flown_its_plan_to_the_end() -> None:
    sky = Sky()
    sky.slots_s = 99.0
    sky.see(1, Condition.CRASHED)
    assert sky.look() == {"a": "crashed"}
    loss = sky.roster.left_its_plan("a")
    assert loss is not None
    assert loss.kind == "crashed"


def test_the_air_of_one_that_lost_its_place_and_then_falls_silent_is_reserved_where_it_was() -> None:
    sky = Sky()
    sky.look()
    sky.told[1]["place_deg"] = None
    sky.silent_s[1] = 6.0
    assert sky.look() == {"a": "heartbeat_lost"}
    assert sky.reserved == {"a"}


def test_who_was_sent_home_by_order_stays_so_when_it_has_landed() -> None:
    sky = Sky()
    asyncio.run(sky.roster.retire("a"))
    sky.told[1] = {"armed": False, "relative_alt_m": 0.0}
    sky.see(1, Condition.LANDED)
    sky.look()
    assert sky.roster.losses["a"].kind == "landed"
    assert sky.roster.retired == {"a"}
    sky.roster.readmit("a")
    assert sky.roster.retired == set()


def test_a_uav_that_a_human_has_just_taken_is_not_commanded_even_before_that_counts_as_a_loss() -> None:
    sky = Sky()
    assert sky.roster.may_command("a")
    sky.flown_by[1] = "somebody else flies it: in mode 'position', which was not commanded"
    assert sky.look() == {}
    assert not sky.roster.may_command("a")
    assert sky.roster.may_command("b")
    sky.flown_by.clear()
    assert sky.roster.may_command("a")


def test_who_has_too_little_energy_for_the_plan_is_offered_as_low_on_battery() -> None:
    sky = Sky()
    sky.lacks["b"] = "3.0 Wh too little"
    assert sky.roster.low_on_battery == {"b": "3.0 Wh too little"}
    assert asyncio.run(sky.roster.retire("b")).detail == "sent home by the operator: 3.0 Wh too little"
    assert sky.roster.low_on_battery == {}
