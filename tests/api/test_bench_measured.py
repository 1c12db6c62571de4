"""Kinds of channels beside measurements that are made here, where it is known which kind is right."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from skyfolio.api.lab.bench.measured import Links, links_of, measured_figures, models
from tests.api.test_cli import run

CARRIER_HZ = 1.8e9


def made(name: str, *, offset_db: float, noise_db: float, seed: int = 1, rows: int = 2000) -> Links:
    """Return links of a model, with an offset and with errors of a standard deviation."""
    rng, channel = np.random.default_rng(seed), models(CARRIER_HZ)[name]
    away, height = rng.uniform(20.0, 900.0, rows), rng.uniform(30.0, 150.0, rows)
    gain = 10.0 * np.log10(channel.power_gain(away, np.hypot(away, height), height))
    return Links(away, height, gain + offset_db + rng.normal(0.0, noise_db, rows))


@pytest.mark.parametrize("name", ["rician (free space)", "los_probability, dense_urban", "3gpp_uav, UMi-AV"])
def test_the_kind_that_made_the_measurements_is_the_one_that_is_least_off(name: str) -> None:
    rows = {row["what"]: row for row in measured_figures(made(name, offset_db=17.0, noise_db=2.0), CARRIER_HZ)["rows"]}
    assert min(rows, key=lambda one: rows[one]["median_db"]) == name
    assert rows[name]["offset_db"] == pytest.approx(17.0, abs=0.3)
    assert rows[name]["median_db"] == pytest.approx(2.0 * 0.6745, abs=0.15)  # of a normal distribution
    assert rows[name]["p90_db"] == pytest.approx(2.0 * 1.645, abs=0.3)


def test_errors_are_of_links_that_the_offset_was_not_fitted_to() -> None:
    """Where the two halves differ by 10 dB, the error is those 10 dB, and not half of them."""
    name = "rician (free space)"
    plain = made(name, offset_db=0.0, noise_db=0.0)
    blocks = np.arange(2000) // 100 % 2
    rows = {
        row["what"]: row
        for row in measured_figures(plain._replace(gain_db=plain.gain_db + 10.0 * blocks), CARRIER_HZ)["rows"]
    }
    assert rows[name]["offset_db"] == pytest.approx(0.0, abs=1e-9)
    assert rows[name]["median_db"] == pytest.approx(10.0, abs=1e-9)


@pytest.mark.parametrize(
    ("text", "rule"),
    [
        ("away_m,height_m\n1,2\n", "there is no gain_db"),
        ("away_m,height_m,gain_db\n1,2,x\n", "row 2, gain_db: 'x' is no number"),
        ("away_m,height_m,gain_db\n1,2,-90\n-1,2,-90\n", "row 3, away_m: -1 must be"),
        ("away_m,height_m,gain_db\n1,2,-90\n", "it has 1 measurements; at least 40"),
    ],
)
def test_a_file_that_has_no_measurements_is_refused_by_row_and_column(text: str, rule: str) -> None:
    with pytest.raises(ValueError, match=rule):
        links_of(text)


def test_the_command_prints_the_errors_of_every_kind(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    links = made("3gpp_uav, RMa-AV", offset_db=-8.0, noise_db=1.0, rows=200)
    lines = [",".join(f"{value:.3f}" for value in row) for row in zip(*links, strict=True)]
    (tmp_path / "links.csv").write_text("\n".join(["away_m,height_m,gain_db", *lines]))
    assert run(monkeypatch, "bench", "channels", str(tmp_path / "links.csv"), "--json") == 0
    rows = json.loads(capsys.readouterr().out)["rows"]
    assert "3gpp_uav, UMa-AV" in {row["what"] for row in rows}
    (tmp_path / "bad.csv").write_text("a,b\n1,2\n")
    assert run(monkeypatch, "bench", "channels", str(tmp_path / "bad.csv")) != 0
    assert "bad.csv: it must have the columns away_m" in capsys.readouterr().err
