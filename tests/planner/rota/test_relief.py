"""A relief as changes and pins of a replan: nobody else moves, nobody comes too near, the station is never empty."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skyfolio.planner import EXAMPLES, Changes, PinError, Plan, Scenario, Uav, User, plan, replan, violations
from skyfolio.planner.rota.relief import Relief, ReliefError, relief_pins
from skyfolio.planner.scenario import Battery, NoFlyDisc, Wind

STATIONS_M = ((60.0, 60.0), (200.0, 60.0), (130.0, 200.0))
PADS_M = ((10.0, 10.0), (25.0, 10.0), (40.0, 10.0), (55.0, 10.0))
BATTERY = Battery(usable_wh=60.0)


def network(**changes: Any) -> Scenario:
    """Three UAVs at their stations, users around them, pads in one corner."""
    rng = np.random.default_rng(3)
    fields: dict[str, Any] = {
        "area_m": ((0.0, 0.0), (300.0, 300.0)),
        "slots": 10,
        "slot_duration_s": 5.0,
        "altitude_m": 40.0,
        "min_separation_m": 6.0,
        "uavs": tuple(
            Uav(
                id=f"uav-{u}",
                start_m=place,
                max_speed_mps=5.0,
                home_m=PADS_M[u],
                battery=BATTERY.model_copy(update={"used_wh": 20.0}),
            )
            for u, place in enumerate(STATIONS_M)
        ),
        "users": tuple(
            User(
                id=f"user-{k}",
                position_m=(
                    float(STATIONS_M[k % 3][0] + rng.normal(0, 20)),
                    float(STATIONS_M[k % 3][1] + rng.normal(0, 20)),
                ),
            )
            for k in range(9)
        ),
        "wind": Wind(east_mps=1.0, north_mps=0.5, gust_mps=0.5),
        **changes,
    }
    return EXAMPLES["minimal"]().with_changes(**fields)


RELIEVER = Uav(
    id="uav-9",
    start_m=PADS_M[3],
    max_speed_mps=5.0,
    battery=BATTERY.model_copy(update={"used_wh": 1.0}),
    home_m=PADS_M[3],
)


@pytest.fixture(scope="module")
def flown() -> Plan:
    return plan(network(), n_starts=2)


def relieved_by(made: Plan, relief: Relief, at_slot: int, **options: Any) -> Plan:
    return replan(made, at_slot=at_slot, changes=relief.changes, pins=relief.pins, n_starts=1, **options)


def test_the_station_is_handed_over_and_nobody_else_moves_differently(flown: Plan) -> None:
    relief = relief_pins(flown, at_slot=4, horizon=20, reliever=RELIEVER, relieved="uav-1")
    again = relieved_by(flown, relief, 4)
    assert violations(again) == []
    assert again.cause.kind == "relief"
    station = flown.trajectories_m["uav-1"][-1]
    relieved, reliever = again.trajectories_m["uav-1"], again.trajectories_m["uav-9"]
    assert relieved[: relief.hand_over_at - 4 + 1][-1] == pytest.approx(station)
    assert relieved[relief.home_at - 4] == pytest.approx(PADS_M[1])  # type: ignore[operator]
    assert reliever[relief.on_station_at - 4] == pytest.approx(station)
    assert reliever[-1] == pytest.approx(station)
    assert 4 < relief.beside_at <= relief.hand_over_at < relief.on_station_at
    for other in ("uav-0", "uav-2"):
        rest = flown.trajectories_m[other][4:]
        assert again.trajectories_m[other][: len(rest)] == rest
    leaves = again.scenario.uav("uav-1").leaves_at_slot
    assert leaves == relief.home_at - 4 + 1  # type: ignore[operator]
    served_by = [row[-1] for row in again.association.values()]
    assert "uav-9" in served_by
    assert "uav-1" not in served_by


def test_in_every_slot_one_of_the_two_is_at_the_station_or_beside_it(flown: Plan) -> None:
    relief = relief_pins(flown, at_slot=4, horizon=20, reliever=RELIEVER, relieved="uav-1")
    again = relieved_by(flown, relief, 4)
    station = np.array(flown.trajectories_m["uav-1"][-1])
    leaves = again.scenario.uav("uav-1").leaves_at_slot or 0
    for n in range(relief.hand_over_at - 4, again.scenario.slots):
        near = [np.linalg.norm(np.array(again.trajectories_m["uav-9"][n]) - station)]
        if n < leaves:
            near.append(np.linalg.norm(np.array(again.trajectories_m["uav-1"][n]) - station))
        assert min(near) <= 3.0 * 6.0 + 1e-6


def test_a_hand_over_is_when_it_is_asked_for_and_not_before_it_can_be(flown: Plan) -> None:
    later = relief_pins(flown, at_slot=4, horizon=20, reliever=RELIEVER, relieved="uav-1", hand_over_slot=30)
    assert later.hand_over_at == 30
    assert later.beside_at < 30
    assert later.changes.slots is not None
    assert later.changes.slots > 30 - 4
    assert violations(relieved_by(flown, later, 4)) == []
    with pytest.raises(ReliefError, match=r"hand_over_slot: 5 is too early, it is beside from slot \d+ on"):
        relief_pins(flown, at_slot=4, horizon=20, reliever=RELIEVER, relieved="uav-1", hand_over_slot=5)


def test_the_station_of_a_lost_uav_is_taken_over(flown: Plan) -> None:
    station = flown.trajectories_m["uav-2"][-1]
    spare = relief_pins(flown, at_slot=4, horizon=20, reliever=RELIEVER, station_m=station, failed=["uav-2"])
    again = relieved_by(flown, spare, 4, failed=["uav-2"])
    assert violations(again) == []
    assert again.trajectories_m["uav-9"][spare.on_station_at - 4] == pytest.approx(station)
    assert spare.home_at is None
    assert "uav-2" not in again.trajectories_m


def test_a_relief_begins_where_everybody_is(flown: Plan) -> None:
    east, north = flown.trajectories_m["uav-1"][4]
    live = {"uav-1": (east + 3.0, north - 2.0), "uav-0": flown.trajectories_m["uav-0"][4]}
    relief = relief_pins(flown, at_slot=4, horizon=20, reliever=RELIEVER, relieved="uav-1", positions_m=live)
    again = relieved_by(flown, relief, 4, positions_m=live)
    assert again.trajectories_m["uav-1"][0] == live["uav-1"]
    assert violations(again) == []


def test_reliefs_follow_each_other(flown: Plan) -> None:
    first = relief_pins(flown, at_slot=4, horizon=20, reliever=RELIEVER, relieved="uav-1")
    made = relieved_by(flown, first, 4)
    again = (first.home_at or 0) + 1
    fresh = RELIEVER.model_copy(update={"id": "uav-8", "start_m": PADS_M[1], "home_m": PADS_M[1]})
    second = relief_pins(made, at_slot=again, horizon=20, reliever=fresh, relieved="uav-0", pad_m=PADS_M[0])
    last = relieved_by(made, second, again)
    assert set(last.scenario.uav_ids) == {"uav-0", "uav-2", "uav-9", "uav-8"}
    assert violations(last) == []
    extended = replan(last, at_slot=second.home_at or 0, changes=Changes(slots=20), n_starts=1)
    assert violations(extended) == []
    assert "uav-0" in extended.trajectories_m


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ({}, "give who is relieved, or which station"),
        ({"relieved": "uav-1", "station_m": (1.0, 1.0)}, "give who is relieved, or which station"),
        ({"relieved": "uav-7"}, "relieved: 'uav-7' is not a UAV of the plan"),
        ({"station_m": (130.0, 200.0)}, "no way was found on which 'uav-9' reaches its station"),
    ],
)
def test_reliefs_that_make_no_sense_are_refused(flown: Plan, asked: dict[str, Any], message: str) -> None:
    with pytest.raises(ReliefError, match=message):
        relief_pins(occupied(flown), at_slot=4, horizon=20, reliever=RELIEVER, **asked)


def occupied(flown: Plan) -> Plan:
    """The plan, with uav-2 exactly at its station throughout."""
    path = [STATIONS_M[2]] * flown.scenario.slots
    return flown.model_copy(update={"trajectories_m": {**flown.trajectories_m, "uav-2": path}})


def test_a_reliever_whose_energy_does_not_last_is_refused(flown: Plan) -> None:
    tired = RELIEVER.model_copy(update={"battery": Battery(usable_wh=10.0, used_wh=5.5)})
    with pytest.raises((ReliefError, PinError), match="uav-9"):
        relief_pins(flown, at_slot=4, horizon=20, reliever=tired, relieved="uav-1")


def test_without_a_home_the_pad_has_to_be_said_in_a_replan() -> None:
    uavs = tuple(uav.model_copy(update={"home_m": None, "battery": None}) for uav in network().uavs)
    made = plan(network(uavs=uavs), n_starts=1)
    again = replan(made, at_slot=2, changes=Changes(slots=20), n_starts=1)
    with pytest.raises(ReliefError, match="pad_m: give where 'uav-1' lands"):
        relief_pins(again, at_slot=4, horizon=20, reliever=RELIEVER, relieved="uav-1")
    assert relief_pins(again, at_slot=4, horizon=20, reliever=RELIEVER, relieved="uav-1", pad_m=PADS_M[1]).home_at
    assert relief_pins(made, at_slot=4, horizon=20, reliever=RELIEVER, relieved="uav-1").home_at


@given(st.sampled_from(("uav-0", "uav-1", "uav-2")), st.integers(1, 8), st.integers(0, 1000))
@settings(max_examples=15)
def test_every_relief_that_is_found_makes_a_feasible_replan(
    flown: Plan, relieved: str, at_slot: int, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    zones = [NoFlyDisc(center_m=(float(e), float(n)), radius_m=12.0) for e, n in rng.uniform(80, 180, size=(3, 2))]
    paths = np.array(list(flown.trajectories_m.values()))
    free = tuple(zone for zone in zones if np.linalg.norm(paths - zone.center_m, axis=2).min() > 60.0)
    made = flown.model_copy(update={"scenario": flown.scenario.with_changes(no_fly=free)})
    start = (float(rng.uniform(0, 50)), float(rng.uniform(250, 300)))
    reliever = RELIEVER.model_copy(update={"start_m": start})
    try:
        relief = relief_pins(made, at_slot=at_slot, horizon=15, reliever=reliever, relieved=relieved)
    except ReliefError:
        return
    assert violations(relieved_by(made, relief, at_slot)) == []
