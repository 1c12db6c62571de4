"""Channels in documents: what is accepted, refused and kept; and the recipe for a kind of one's own."""

from __future__ import annotations

import importlib
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from skyfolio.planner import EXAMPLES, Channel, Scenario, plan, violations
from skyfolio.planner.channels.kinds import KINDS, channel_of
from skyfolio.planner.channels.radio import RadioChannel
from skyfolio.planner.problem import problem_of
from tests.planner.channels.any_kind import CHANNELS


def document(**channel: Any) -> dict[str, Any]:
    easy = EXAMPLES["minimal"]().model_dump(mode="json")
    return {**easy, "channel": channel}


@pytest.mark.parametrize("name", CHANNELS)
def test_a_scenario_comes_back_from_its_document(name: str) -> None:
    scenario = Scenario.model_validate(document(**CHANNELS[name]) | {"altitude_m": 60.0})
    assert Scenario.model_validate_json(scenario.model_dump_json()) == scenario
    assert scenario.with_changes(slots=3).channel == scenario.channel


def test_the_letters_channel_is_written_as_it_was() -> None:
    assert list(Channel().model_dump()) == ["reference_gain_db", "noise_dbm", "rician_k_db", "fading", "draws", "seed"]
    assert channel_of({}) == channel_of({"kind": "rician"}) == Channel()


@pytest.mark.parametrize(
    ("channel", "field", "rule"),
    [
        ({"kind": "cost231"}, "channel.kind", "there are rician, los_probability, 3gpp_uav"),
        ({"kind": 7}, "channel.kind", "there are"),
        ({"kind": "3gpp_uav", "reference_gain_db": -20.0}, "channel.reference_gain_db", "not permitted"),
        ({"environment": "urban"}, "channel.environment", "not permitted"),
        ({"kind": "los_probability", "environment": "jungle"}, "channel.environment", "suburban"),
        ({"kind": "los_probability", "carrier_hz": 1e7}, "channel.carrier_hz", "greater than or equal to 100000000"),
        ({"kind": "3gpp_uav", "environment": "urban"}, "channel.environment", "UMa-AV"),
        ({"noise_dbm": -80.0, "noise_figure_db": 5.0}, "channel", "not by both"),
        ({"noise_dbm": None}, "channel", "needs noise_dbm or noise_figure_db"),
        ({"noise_figure_db": -1.0}, "channel.noise_figure_db", "greater than or equal to 0"),
        ({"antenna": {"kind": "dish"}}, "channel.antenna", "'beam', 'dipole'"),
        ({"antenna": {"kind": "beam", "tilt_deg": 91.0}}, "channel.antenna.beam.tilt_deg", "less than or equal to 90"),
    ],
)
def test_a_bad_channel_is_refused_by_field_and_rule(channel: dict[str, Any], field: str, rule: str) -> None:
    with pytest.raises(ValidationError) as refused:
        Scenario.model_validate(document(**channel))
    rows = [(".".join(map(str, row["loc"])), row["msg"]) for row in refused.value.errors()]
    assert any(at == field and rule in said for at, said in rows), rows


def test_altitudes_for_which_a_kind_has_no_formulas_are_refused() -> None:
    bad = document(kind="3gpp_uav") | {"altitude_m": 20.0}
    with pytest.raises(ValidationError, match=r"channel\.kind: .* 22\.5 to 300 m, not for 20 to 20 m of uavs\.0"):
        Scenario.model_validate(bad)
    Scenario.model_validate(document(kind="3gpp_uav", environment="RMa-AV") | {"altitude_m": 20.0})


def test_the_schema_names_every_kind() -> None:
    schema = Scenario.model_json_schema()
    named = [row["$ref"].rsplit("/", 1)[-1] for row in schema["properties"]["channel"]["anyOf"]]
    assert named == ["Channel", "LosProbability", "Aerial3gpp", "GainMap"]


@pytest.fixture
def log_distance(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> type[RadioChannel]:
    """The kind that docs/channels.md shows how to add: its file, imported."""
    page = (Path(__file__).parents[3] / "docs" / "channels.md").read_text()
    [source] = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    (tmp_path / "log_distance.py").write_text(source)
    monkeypatch.syspath_prepend(str(tmp_path))
    made: type[RadioChannel] = importlib.import_module("log_distance").LogDistance
    return made


def test_a_kind_of_ones_own_is_a_class_and_a_row(
    log_distance: type[RadioChannel], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(KINDS, "log_distance", log_distance)
    given = {"kind": "log_distance", "exponent": 3.0, "noise_figure_db": 7.0, "antenna": {"kind": "dipole"}}
    scenario = Scenario.model_validate(document(**given))
    assert Scenario.model_validate_json(scenario.model_dump_json()) == scenario
    made = plan(scenario, n_starts=2)
    assert violations(made) == []
    assert made.summary.utility_bps <= made.summary.upper_bound_bps
    plain = problem_of(scenario.with_changes(channel=channel_of({"kind": "log_distance", "noise_figure_db": 7.0})))
    noise_w = 10 ** (-17.4 + 0.7 - 3.0) * plain.bandwidth_hz[0]
    d2 = plain.distances2(plain.hover())
    expected = scenario.uavs[0].transmit_power_w * 1e-4 / d2[0, 0, 0] ** 1.35 / noise_w
    assert plain.snr(plain.hover())[0, 0, 0] == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("kind", KINDS)
def test_gains_fall_with_distances_and_rise_with_height_as_bounds_take_for_granted(kind: str) -> None:
    rng = np.random.default_rng(1)
    channel = channel_of(CHANNELS["map"]) if kind == "map" else KINDS[kind]()
    least, most = max(channel.heights_m[0], 1.0), min(channel.heights_m[1], 400.0)
    away, height = rng.uniform(0, 2000, 4000), rng.uniform(least, most, 4000)
    distance = rng.uniform(10, 2000, 4000)
    gain = channel.power_gain(away, distance, height) * (1 + 1e-9)
    more = rng.uniform(0, 500, 4000)
    assert (channel.power_gain(away + more, distance, height) <= gain).all()
    assert (channel.power_gain(away, distance + more, height) <= gain).all()
    assert (channel.power_gain(away, distance, np.maximum(height - more, least)) <= gain).all()
