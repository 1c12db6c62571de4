"""Explanations as tables: every user and every number that is worth something, with how it was obtained."""

from skyfolio.api.dashboard import reasons
from skyfolio.planner import Budget, Explanation, Pins, Plan, Scenario, explain, plan


def explained(made: Plan) -> Explanation:
    return explain(made, budget=Budget(starts=1, most_resolves=6))


def test_every_user_has_a_row_and_those_with_little_a_reason_with_its_method(minimal: Scenario) -> None:
    made = plan(minimal.with_changes(users=(*minimal.users,)), pins=Pins(associations={"user-1": "uav-2"}))
    found = explained(made)
    rows = reasons.users(found)
    assert sorted(row[0] for row in rows) == sorted(minimal.user_ids)
    assert [float(row[1]) for row in rows] == sorted(float(row[1]) for row in rows)
    for row in rows:
        if row[2] == "its share":
            assert row[3:] == ("", "", "", "")
        else:
            assert row[2] in {"nothing", "little"}
            assert row[3] in reasons.BECAUSE.values()
            assert row[5] in reasons.HOW.values()
            assert row[6]
    assert {len(row) for row in rows} == {len(reasons.USERS_HEAD)}
    assert str(sum(row[2] != "its share" for row in rows)) in reasons.summary(found)


def test_worths_and_prices_say_how_each_number_was_obtained(small_plan: Plan) -> None:
    found = explained(small_plan)
    worths = reasons.worths(found)
    assert {row[0] for row in worths} == set(reasons.WHATS.values())
    assert {row[4] for row in worths} == set(reasons.HOW.values())
    assert len(worths) == len(found.worth)
    assert {len(row) for row in worths} == {len(reasons.WORTHS_HEAD)}
    prices = reasons.prices(found)
    assert len(prices) == sum(row.slots > 0 for row in found.constraints)
    assert all(row[0] in reasons.CONSTRAINTS.values() and row[5] in reasons.HOW.values() for row in prices)


def test_a_constraint_without_a_price_is_shown_with_a_dash(small_plan: Plan) -> None:
    bounds_only = explain(small_plan.model_copy(update={"pins": Pins(uavs=("uav-1",))}), budget=Budget(most_cells=0))
    pinned = next(row for row in reasons.prices(bounds_only) if row[0] == "pins")
    assert pinned[1] == "uav-1"
    assert pinned[3] == "–"  # noqa: RUF001
