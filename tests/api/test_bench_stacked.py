"""What separation by altitude would gain and cost."""

from skyfolio.api.lab.bench import stacked
from skyfolio.planner import MaxIterations, plan


def test_no_failsafe_keeps_a_distance_in_altitude_and_all_keep_one_over_ground() -> None:
    flown = {(one.autopilot, one.what): one for one in stacked.costs()}
    assert len(flown) == 4
    assert all(one.beside_m > 7.9 for one in flown.values())
    assert flown["px4", "the lower one returns"].stacked_m < 0.5
    assert {round(flown[name, "the upper one lands"].stacked_m) for name in ("px4", "ardupilot")} == {0}


def test_what_a_crowd_could_gain_without_any_separation_is_counted_from_the_same_scenario() -> None:
    scenario = stacked.crowd(1)
    made = plan(scenario.with_changes(min_separation_m=0.0), n_starts=1, stop=MaxIterations(2))
    assert made.altitudes_m is not None
    assert stacked.closest_m(made) < 40.0
    gain = stacked._gain("crowd", scenario)
    assert gain.apart_kbps <= gain.free_kbps * 1.001
    assert gain.free_kbps < gain.apart_kbps * 1.05
