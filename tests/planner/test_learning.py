"""What measured SINR say about links: the true corrections come back, outliers and unmeasured links do no harm."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import pytest

from skyfolio.planner import EXAMPLES, Channel, Observation, Scenario, learned_corrections_db
from skyfolio.planner.areas import size
from skyfolio.planner.corrections import link_factors

NOISY = -45.0
"""dBm: noise, not interference, is what limits the letter's users then."""


def scenario(noise_dbm: float) -> Scenario:
    letter = EXAMPLES["paper"]()
    return letter.with_changes(channel=letter.channel.model_copy(update={"noise_dbm": noise_dbm}))


def measured(
    of: Scenario, truth_db: Mapping[tuple[str, str], float], slots: int = 5, error_db: float = 1.0, seed: int = 1
) -> list[Observation]:
    """What every user measures, served by the UAV beside it, while UAVs move about; worked out by hand from eq. (4)."""
    rng = np.random.default_rng(seed)
    channel = of.channel
    assert isinstance(channel, Channel)
    assert channel.noise_dbm is not None
    noise_w, gain = 10 ** (channel.noise_dbm / 10 - 3), 10 ** (channel.reference_gain_db / 10)
    found = []
    for slot in range(slots):
        at_m = {uav.id: (uav.start_m[0] + rng.normal(0, 20), uav.start_m[1] + rng.normal(0, 20)) for uav in of.uavs}
        for number, user in enumerate(of.users):
            serving = of.uavs[number // 3].id
            powers = {}
            for uav in of.uavs:
                away2 = (at_m[uav.id][0] - user.position_m[0]) ** 2 + (at_m[uav.id][1] - user.position_m[1]) ** 2
                factor = 10 ** (truth_db[uav.id, user.id] / 10)
                powers[uav.id] = uav.transmit_power_w * gain * factor / (away2 + of.altitude_m**2)
            sinr = powers[serving] / (noise_w + sum(power for uav, power in powers.items() if uav != serving))
            sinr_db = 10 * np.log10(sinr) + rng.normal(0, error_db)
            found.append(
                Observation(user_id=user.id, uav_id=serving, sinr_db=float(sinr_db), slot=slot, positions_m=at_m)
            )
    return found


def truth_of(of: Scenario, db: Callable[[int, int], float]) -> dict[tuple[str, str], float]:
    return {(uav.id, user.id): db(u, k) for u, uav in enumerate(of.uavs) for k, user in enumerate(of.users)}


def serving_error_db(
    of: Scenario, learned: dict[str, dict[str, float]], truth_db: Mapping[tuple[str, str], float]
) -> float:
    """Root mean square error of the links that serve."""
    errors = []
    for number, user in enumerate(of.users):
        uav = of.uavs[number // 3].id
        errors.append(learned.get(uav, {}).get(user.id, 0.0) - truth_db[uav, user.id])
    return float(np.sqrt(np.mean(np.square(errors))))


def test_without_a_measurement_nothing_is_corrected() -> None:
    assert learned_corrections_db(scenario(NOISY), []) == {}


def test_a_channel_that_is_as_assumed_stays_as_it_is() -> None:
    of = scenario(NOISY)
    truth = truth_of(of, lambda _u, _k: 0.0)
    learned = learned_corrections_db(of, measured(of, truth))
    assert max(abs(db) for row in learned.values() for db in row.values()) < 1.5


@pytest.mark.parametrize("bias_db", [-6.0, 3.0])
def test_a_bias_of_all_links_is_found_and_holds_for_links_that_nobody_measured(bias_db: float) -> None:
    of = scenario(NOISY)
    truth = truth_of(of, lambda _u, _k: bias_db)
    learned = learned_corrections_db(of, measured(of, truth))
    assert serving_error_db(of, learned, truth) < 1.0
    assert learned["uav-3"]["user-1"] == pytest.approx(bias_db, abs=1.5)  # uav-1 serves that user


def test_where_interference_drowns_the_noise_a_bias_of_all_links_changes_nothing_and_is_not_invented() -> None:
    of = scenario(-80.0)
    learned = learned_corrections_db(of, measured(of, truth_of(of, lambda _u, _k: -6.0)))
    assert max(abs(db) for row in learned.values() for db in row.values()) < 1.5


def test_one_uav_with_wrong_power_is_told_from_the_others() -> None:
    of = scenario(NOISY)
    truth = truth_of(of, lambda u, _k: -8.0 if u == 1 else 0.0)
    learned = learned_corrections_db(of, measured(of, truth))
    assert serving_error_db(of, learned, truth) < 1.5
    assert learned["uav-2"]["user-1"] < -2.0  # not measured, but of that UAV


def test_one_shadowed_link_is_corrected_and_its_neighbours_hardly() -> None:
    of = scenario(NOISY)
    truth = truth_of(of, lambda u, k: -15.0 if (u, k) == (0, 1) else 0.0)
    learned = learned_corrections_db(of, measured(of, truth))
    assert learned["uav-1"]["user-2"] == pytest.approx(-15.0, abs=3.0)
    assert abs(learned["uav-1"].get("user-1", 0.0)) < 2.0


def test_wild_measurements_hardly_count() -> None:
    of = scenario(NOISY)
    truth = truth_of(of, lambda _u, _k: -6.0)
    honest = measured(of, truth, slots=8)
    wild = [
        Observation(user_id=one.user_id, uav_id=one.uav_id, sinr_db=40.0, slot=one.slot, positions_m=one.positions_m)
        for one in honest[::11]
    ]
    learned = learned_corrections_db(of, [*honest, *wild])
    assert serving_error_db(of, learned, truth) < 2.0


def test_what_was_measured_last_counts_most() -> None:
    of = scenario(NOISY)
    before = measured(of, truth_of(of, lambda _u, _k: 0.0), slots=6)
    after = [replace(one, slot=one.slot + 6) for one in measured(of, truth_of(of, lambda _u, _k: -20.0), slots=3)]
    learned = learned_corrections_db(of, [*before, *after])
    assert serving_error_db(of, learned, truth_of(of, lambda _u, _k: -20.0)) < 4.5


def test_a_link_that_is_not_of_the_scenario_is_refused() -> None:
    of = scenario(NOISY)
    one = Observation(user_id="user-1", uav_id="uav-9", sinr_db=0.0, slot=0, positions_m={"uav-9": (0.0, 0.0)})
    with pytest.raises(ValueError, match="observations: 'uav-9' serving 'user-1'"):
        learned_corrections_db(of, [one])


def test_corrections_by_id_are_factors_in_the_order_of_the_scenario() -> None:
    factors = link_factors({"b": {"y": 10.0}}, ["a", "b"], ["x", "y"])
    assert factors.tolist() == [[1.0, 1.0], [1.0, pytest.approx(10.0)]]


def test_of_a_fleet_that_is_planned_by_areas_what_uavs_have_in_common_is_learned(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(size, "MOST_AT_ONCE", 1)
    of = scenario(NOISY)
    shifts = (-8.0, 3.0, 0.0)
    seen = measured(of, truth_of(of, lambda u, k: shifts[u] + (1.0 if k % 2 else -1.0)), slots=8)
    learned = learned_corrections_db(of, seen)
    assert all(row.keys() == {"*"} for row in learned.values())
    for uav, shift in zip(of.uav_ids, shifts, strict=True):
        assert learned.get(uav, {}).get("*", 0.0) == pytest.approx(shift, abs=2.5)
    assert learned["uav-1"]["*"] < learned.get("uav-3", {}).get("*", 0.0) < learned["uav-2"]["*"]
