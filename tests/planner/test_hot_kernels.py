"""What is called for every step, pair or user takes no whole arena: handing that on takes longer than the work."""

from __future__ import annotations

import inspect
from typing import Any

import pytest

from skyfolio.planner.fast import bent, exchange, flight, links_narrow, links_wide, market, matching, snapshots

HOT: tuple[Any, ...] = (
    flight.plain_step,
    flight._near_pairs,
    flight._push_apart,
    market.fill,
    market._share,
    market.water_fill,
    exchange._promising,
    exchange._try,
    matching.match,
    links_narrow.mean_signals,
    links_wide._listen_to,
    snapshots._after,
    snapshots._hear,
    bent.hear_bent,
    bent.bent_signals,
)


@pytest.mark.parametrize("kernel", HOT, ids=lambda kernel: kernel.py_func.__name__)
def test_a_kernel_that_is_called_all_the_time_takes_what_it_needs_and_no_more(kernel: Any) -> None:
    assert not {"arena", "bend"} & set(inspect.signature(kernel.py_func).parameters)
