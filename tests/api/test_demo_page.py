"""What a reader of the drill's report sees first."""

from typing import Any

import numpy as np
import pytest

from skyfolio.api.lab.demo.charts import COLOURS, by_slot, service, tracks
from skyfolio.api.lab.demo.orders import DemoConfig
from skyfolio.api.lab.demo.page import figures, headline
from skyfolio.api.lab.demo.report import DemoReport, Rates
from skyfolio.planner import EXAMPLES, plan, replan

USERS = ("user-1", "user-2", "user-3", "user-4")


def rates(table_bps: list[list[float]]) -> Rates:
    """Of four users in four slots; nobody is told from the table."""
    mean = np.array(table_bps).mean(axis=1)
    return Rates(
        mean_sum_rate_before_bps=1.0,
        mean_sum_rate_during_bps=None,
        mean_sum_rate_after_bps=1.0,
        worst_user_after_bps=float(mean.min()),
        unserved_after=[user for user, row in zip(USERS, table_bps, strict=True) if row[-1] == 0.0],
        utility_bps=1.0,
        sum_rate_variance_kbps2=1.0,
        jain=1.0,
        sum_rate_bps=np.array(table_bps).sum(axis=0).tolist(),
        user_rates_bps=dict(zip(USERS, table_bps, strict=True)),
    )


def report(**changes: Any) -> DemoReport:
    """uav-2 falls 10 s after the start of 20 s, and a new plan is in force 4 s later."""
    everybody = rates([[3e3] * 4] * 4)
    some = rates([[4e3] * 4, [4e3] * 4, [4e3, 4e3, 0.0, 0.0], [4e3, 4e3, 200.0, 0.0]])
    given: dict[str, Any] = {
        "passed": True,
        "checks": [],
        "replanned": True,
        "speedup": 5.0,
        "utility": EXAMPLES["minimal"]().utility,
        "killed": "uav-2",
        "killed_at_slot": 3,
        "killed_at_s": 10.0,
        "detection_s": 3.0,
        "replan_ms": 12.0,
        "upload_s": 0.1,
        "new_plan_in_force_at_s": 14.0,
        "slots_without_service": 0.8,
        "measured_slots": [0, 1, 2],
        "flown": everybody,
        "no_replan": some,
        "foreseen": everybody,
        "tracking": {},
        "plans": [plan(EXAMPLES["minimal"]())],
        "tracks_m": {},
        "wall_s": 1.0,
    }
    return DemoReport(**{**given, **changes})


def test_the_first_sentence_says_who_lost_service_for_how_long_and_what_it_would_have_been() -> None:
    assert headline(report()) == (
        "uav-2 fell in slot 3: user-3 and user-4 had no service for 4.0 s, until others served them; without "
        "that it would have been 10 s, to the end."
    )


def test_the_first_sentence_does_not_praise_a_replan_that_was_none_or_left_users_out() -> None:
    none = report(replanned=False, new_plan_in_force_at_s=None, slots_without_service=2.0)
    assert headline(none) == "uav-2 fell in slot 3: user-3 and user-4 had no service for the 10 s that were left."
    left_out = rates([[3e3] * 4, [3e3] * 4, [3e3] * 4, [0.0] * 4])
    assert headline(report(flown=left_out)).endswith("to the end; user-4 stayed without it.")
    assert "nobody would have lost service" in headline(report(no_replan=rates([[3e3] * 4] * 4)))


def test_served_users_and_the_worst_of_all_are_counted_in_each_slot() -> None:
    served, worst, total = by_slot(report().no_replan)
    assert served.tolist() == [4, 4, 2, 2]
    assert worst == pytest.approx([4.0, 4.0, 0.0, 0.0])
    assert total == pytest.approx([16.0, 16.0, 8.2, 8.0])


def test_every_row_and_every_panel_shows_what_no_replan_and_foresight_would_give() -> None:
    shown = report()
    assert all(len(row) == 4 for row in figures(shown))
    assert figures(shown)[0] == (
        "rates of users",
        "75% measured, the rest computed at true positions",
        *["computed"] * 2,
    )
    assert figures(report(measured_slots=[]))[0][1] == "computed at true positions"
    assert figures(report(measured_slots=[0, 1, 2, 3]))[0][1] == "measured"
    assert figures(shown)[1] == ("users without service after", "none", "2 (user-3, user-4)", "none")
    assert service(shown).startswith("<svg")


def test_the_map_shows_which_uav_serves_the_users_of_the_lost_one() -> None:
    first = plan(EXAMPLES["minimal"](), n_starts=2)
    second = replan(first, failed=["uav-2"], at_slot=2)
    flown = [(0.0, 50.0, 50.0), (9.0, 60.0, 50.0), (11.0, 65.0, 50.0), (20.0, 90.0, 50.0)]
    shown = tracks(
        report(plans=[first, second], tracks_m={"uav-1": flown, "uav-2": [(0.0, 150.0, 50.0), (10.0, 150.0, 50.0)]})
    )
    assert "uav-2, lost here" in shown
    assert "uav-1, thick after the loss" in shown
    rims = sum(first.association[user][-1] == "uav-2" for user in first.scenario.user_ids)
    assert rims > 0
    assert shown.count(f"fill: {COLOURS[0]}; stroke: {COLOURS[1]}") == rims


def test_in_the_default_drill_a_survivor_flies_far_to_users_who_would_have_nothing() -> None:
    config = DemoConfig()
    scenario = EXAMPLES["paper"]().with_changes(utility=config.scenario.utility)
    first = plan(scenario)
    second = replan(first, failed=[config.kill], at_slot=config.kill_slot - 1)
    moved = [np.linalg.norm(np.subtract(path[-1], path[0])) for path in second.trajectories_m.values()]
    assert max(moved) > 150.0
    left = [user for user in scenario.user_ids if first.association[user][-1] == config.kill]
    assert left
    assert min(second.user_rates_bps[user][-1] for user in left) > 1e3
