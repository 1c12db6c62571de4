"""Pins: what a request fixes stays as it is, the rest is planned around it, and what cannot be kept is refused."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skyfolio.planner import (
    EXAMPLES,
    Changes,
    PinError,
    Pins,
    Plan,
    Scenario,
    Uav,
    User,
    Utility,
    plan,
    replan,
    violations,
)
from skyfolio.planner.scenario import NoFlyDisc

KINDS = (("sum", 0.0), ("sum", -0.1), ("per_user", -0.1), ("pooled", -0.1))


@pytest.fixture(scope="module")
def paper() -> Plan:
    return plan(EXAMPLES["paper"](), n_starts=3)


def path_of(made: Plan, uav: str) -> tuple[tuple[float, float], ...]:
    return tuple(made.trajectories_m[uav])


@pytest.mark.parametrize(("kind", "mu"), KINDS)
def test_pinned_paths_and_associations_are_kept_and_the_rest_is_planned_around_them(
    paper: Plan, kind: str, mu: float
) -> None:
    scenario = paper.scenario.with_changes(utility=Utility.model_validate({"kind": kind, "mu_per_kbps": mu}))
    row = (None, *["uav-3"] * (scenario.slots - 1))
    pins = Pins(paths_m={"uav-1": path_of(paper, "uav-1")}, associations={"user-1": "uav-2", "user-5": row})
    made = plan(scenario, pins=pins, n_starts=3)
    assert made.trajectories_m["uav-1"] == paper.trajectories_m["uav-1"]
    assert set(made.association["user-1"]) == {"uav-2"}
    assert set(made.association["user-5"][1:]) == {"uav-3"}
    assert made.trajectories_m["uav-2"] != [scenario.uav("uav-2").start_m] * scenario.slots
    assert made.pins == pins
    assert violations(made) == []


def test_a_pinned_uav_hovers_in_a_plan_and_keeps_its_path_in_a_replan(paper: Plan) -> None:
    made = plan(paper.scenario, pins=Pins(uavs=("uav-2",)), n_starts=2)
    assert set(made.trajectories_m["uav-2"]) == {paper.scenario.uav("uav-2").start_m}
    again = replan(paper, failed=["uav-3"], at_slot=5, pins=Pins(uavs=("uav-1",)), n_starts=2)
    assert again.trajectories_m["uav-1"] == paper.trajectories_m["uav-1"][5:]
    assert list(again.pins.paths_m) == ["uav-1"]
    assert violations(again) == []


def test_a_pinned_uav_off_its_path_catches_up_with_it(paper: Plan) -> None:
    east, north = paper.trajectories_m["uav-1"][5]
    live = {"uav-1": (east + 12.0, north)}
    again = replan(paper, failed=["uav-3"], at_slot=5, positions_m=live, pins=Pins(uavs=("uav-1",)), n_starts=2)
    path, old = np.array(again.trajectories_m["uav-1"]), np.array(paper.trajectories_m["uav-1"][5:])
    assert tuple(path[0]) == live["uav-1"]
    away = np.linalg.norm(path - old, axis=1)
    assert away[-1] < away[0]
    assert violations(again) == []


def test_pins_only_lower_the_utility_and_the_certificate_holds_without_them(paper: Plan) -> None:
    """The bound knows nothing of pins: the best plan without them must stay below it too."""
    best = plan(paper.scenario)
    held = plan(paper.scenario, pins=Pins(uavs=("uav-1", "uav-2"), associations={"user-1": "uav-3"}))
    assert held.summary.utility_bps < best.summary.utility_bps
    assert best.summary.utility_bps <= held.summary.upper_bound_bps


def test_a_free_uav_gives_way_to_a_pinned_one_that_flies_through_its_start() -> None:
    scenario = corridor()
    through = tuple((10.0 * n, 50.0) for n in range(scenario.slots))
    made = plan(scenario, pins=Pins(paths_m={"a": through}), n_starts=4)
    assert path_of(made, "a") == through
    assert violations(made) == []


def test_who_cannot_give_way_is_told(two_uavs_four_users: Any) -> None:
    scenario = two_uavs_four_users(slots=4)
    first, second = scenario.uavs
    fast = scenario.with_changes(uavs=(first.model_copy(update={"max_speed_mps": 5.0}), second))
    onto = ((0.0, 0.0), (15.0, 0.0), (29.0, 0.0), (29.0, 0.0))
    with pytest.raises(PinError, match="pins: no paths were found on which the other UAVs keep min_separation_m"):
        plan(fast, pins=Pins(paths_m={"uav-1": onto}))


def corridor(**changes: Any) -> Scenario:
    """Two UAVs in a row, 50 m apart, that move up to 20 m a slot."""
    fields: dict[str, Any] = {
        "area_m": ((0.0, 0.0), (120.0, 100.0)),
        "slots": 10,
        "slot_duration_s": 5.0,
        "min_separation_m": 8.0,
        "uavs": (
            Uav(id="a", start_m=(0.0, 50.0), max_speed_mps=4.0),
            Uav(id="b", start_m=(50.0, 50.0), max_speed_mps=4.0),
        ),
        "users": tuple(User(id=f"user-{k}", position_m=(30.0 * k, 20.0 + 15.0 * k)) for k in range(4)),
        **changes,
    }
    return EXAMPLES["minimal"]().with_changes(**fields)


HOVER_A = tuple([(0.0, 50.0)] * 10)


@pytest.mark.parametrize(
    ("pins", "changes", "message"),
    [
        ({"uavs": ["z"]}, {}, "pins.uavs: 'z' is not a UAV"),
        ({"paths_m": {"z": HOVER_A}}, {}, "pins.paths_m: 'z' is not a UAV"),
        ({"paths_m": {"a": HOVER_A}, "uavs": ["a"]}, {}, "pins.uavs: 'a' is pinned to another path"),
        ({"paths_m": {"a": HOVER_A[1:]}}, {}, "pins.paths_m.a: has 9 points, but 'a' flies in 10 slots"),
        ({"paths_m": {"a": [(1.0, 50.0), *HOVER_A[1:]]}}, {}, r"begins at \(1.0, 50.0\), .* \(eq. 6g\)"),
        ({"paths_m": {"a": [HOVER_A[0], *[(21.0, 50.0)] * 9]}}, {}, r"would move 21 m in slot 0, .* 20 m \(eq. 6d\)"),
        ({"paths_m": {"a": [HOVER_A[0], *[(-1.0, 50.0)] * 9]}}, {}, r"in slot 1 lies outside area_m .* \(eq. 6f\)"),
        (
            {"paths_m": {"a": [(20.0 * min(n, 3), 50.0) for n in range(10)]}, "uavs": ["b"]},
            {},
            r"pins.paths_m: 'a' and 'b' would come within 0 m, .* min_separation_m 8 \(eq. 6e\)",
        ),
        (
            {"paths_m": {"a": [(20.0 * min(n, 1), 50.0) for n in range(10)]}},
            {"no_fly": (NoFlyDisc(center_m=(10.0, 51.0), radius_m=5.0),)},
            "'a' would enter no_fly.0 in slot 0",
        ),
        (
            {"uavs": ["a"]},
            {"uavs": (Uav(id="a", start_m=(0.0, 50.0), end_m=(9.0, 50.0)), Uav(id="b", start_m=(50.0, 50.0)))},
            r"pins.uavs: 'a' would end at \(0.0, 50.0\), not at its end_m",
        ),
        ({"associations": {"nobody": "a"}}, {}, "pins.associations: 'nobody' is not a user"),
        ({"associations": {"user-0": "z"}}, {}, "pins.associations.user-0: 'z' is not a UAV"),
        ({"associations": {"user-0": ["a"] * 9}}, {}, "pins.associations.user-0: has 9 slots, but the plan has 10"),
        (
            {"associations": {"user-0": "a"}},
            {"uavs": (Uav(id="a", start_m=(0.0, 50.0), leaves_at_slot=4), Uav(id="b", start_m=(50.0, 50.0)))},
            "pins.associations.user-0: 'a' has left by slot 4",
        ),
    ],
)
def test_pins_that_cannot_be_kept_are_refused_by_field_and_rule(
    pins: dict[str, Any], changes: dict[str, Any], message: str
) -> None:
    with pytest.raises(PinError, match=message):
        plan(corridor(**changes), pins=Pins.model_validate(pins), n_starts=1)


def test_only_the_default_method_takes_pins() -> None:
    with pytest.raises(PinError, match="only the method 'fast' keeps pins, not 'static'"):
        plan(corridor(), method="static", pins=Pins(uavs=("a",)))


def test_the_independent_check_finds_a_broken_pin(paper: Plan) -> None:
    pins = Pins(
        paths_m={"uav-1": path_of(paper, "uav-2")},
        associations={"user-1": "uav-1" if paper.association["user-1"][0] != "uav-1" else "uav-2"},
    )
    found = violations(paper.model_copy(update={"pins": pins}))
    assert {one.where.split(" ")[0] for one in found if one.constraint == "pin"} == {"uav-1", "user-1"}


def test_pinned_uavs_that_return_hover_where_they_are(paper: Plan) -> None:
    without = replan(paper, failed=["uav-3"], at_slot=4, n_starts=1)
    back = Uav(id="uav-3", start_m=(300.0, 200.0))
    pins = Pins(uavs=("uav-3",))
    again = replan(without, at_slot=8, changes=Changes(returned=(back,)), pins=pins, n_starts=1)
    assert set(again.trajectories_m["uav-3"]) == {(300.0, 200.0)}


@st.composite
def pinned_scenarios(draw: st.DrawFn) -> tuple[Scenario, Pins]:
    """Small scenarios with ends, leaving UAVs, minimum rates, zones and sampled fading, and pins that can be kept."""
    seed = draw(st.integers(0, 10_000))
    rng = np.random.default_rng(seed)
    n_uavs, n_users = draw(st.integers(2, 5)), draw(st.integers(1, 7))
    slots = draw(st.integers(2, 10))
    starts = [(40.0 + 80.0 * u, float(rng.uniform(20, 280))) for u in range(n_uavs)]
    kind, mu = draw(st.sampled_from(KINDS))
    uavs = [
        Uav(
            id=f"uav-{u}",
            start_m=start,
            max_speed_mps=float(rng.uniform(1, 8)),
            leaves_at_slot=slots - 1 if u == 0 and draw(st.booleans()) and slots > 2 else None,
            end_m=start if u == 1 and draw(st.booleans()) else None,
        )
        for u, start in enumerate(starts)
    ]
    rate = draw(st.sampled_from((0.0, 200.0)))
    scenario = EXAMPLES["minimal"]().with_changes(
        area_m=((0.0, 0.0), (450.0, 300.0)),
        slots=slots,
        slot_duration_s=5.0,
        uavs=tuple(uavs),
        users=tuple(
            User(id=f"user-{k}", position_m=(float(rng.uniform(0, 450)), float(rng.uniform(0, 300))), min_rate_bps=rate)
            for k in range(n_users)
        ),
        utility=Utility.model_validate({"kind": kind, "mu_per_kbps": mu}),
        channel=EXAMPLES["minimal"]().channel.model_copy(update={"fading": draw(st.sampled_from(("mean", "sampled")))}),
    )
    always = [uav.id for uav in uavs if uav.leaves_at_slot is None]
    associations: dict[str, Any] = {
        f"user-{k}": tuple(draw(st.sampled_from((None, *always))) for _ in range(slots)) for k in range(0, n_users, 2)
    }
    pinned_uavs = tuple(uav.id for uav in uavs if draw(st.booleans()))
    return scenario, Pins(uavs=pinned_uavs, associations=associations)


@settings(max_examples=60)
@given(pinned_scenarios())
def test_every_plan_and_replan_keeps_its_pins_with_every_constraint_there_is(case: tuple[Scenario, Pins]) -> None:
    """`plan` runs the independent check; it is run again here, on pins that are set beside the plan's own."""
    scenario, pins = case
    made = plan(scenario, pins=pins, n_starts=2)
    spelt = Pins(
        paths_m={uav: tuple([scenario.uav(uav).start_m] * scenario.slots) for uav in pins.uavs},
        associations=pins.associations,
    )
    assert violations(made.model_copy(update={"pins": spelt})) == []
    if scenario.slots < 3:
        return
    again = replan(made, at_slot=1, pins=Pins(paths_m={"uav-1": path_of(made, "uav-1")[1:]}), n_starts=2)
    assert again.trajectories_m["uav-1"] == made.trajectories_m["uav-1"][1:]
    assert violations(again) == []
