"""The benchmark of drills: how long they take, and for what."""

from __future__ import annotations

import pytest

from skyfolio.api.lab.bench import drills
from skyfolio.api.lab.torture.drill import Drill


def test_the_time_of_a_drill_is_shared_out_among_the_parts_of_the_product(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(drills, "DRILLS", {"small": Drill(seed=2, slots=4)})
    figures = drills.drill_figures(1)
    assert figures["drills"]["small"]["flown_s"] > 20.0
    assert sum(figures["parts"].values()) == pytest.approx(1.0, abs=0.01)
    assert {"simulated vehicles", "bridge", "service", "database", "event loop"} <= set(figures["parts"])
    assert [table.row_count for table in drills.tables(figures)] == [1, len(figures["parts"])]
