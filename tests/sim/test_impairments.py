"""sim.impairments"""

from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skyfolio.sim.fault_schedule import parse_fault
from skyfolio.sim.impairments import Channel, Impairments

N = 20_000


def carry(impairments: Impairments, count: int = N, every_s: float = 0.1, size: int = 100) -> list[tuple[float, int]]:
    """Return (arrival, number) of numbered datagrams sent at even intervals, in order of arrival."""
    channel: Channel[int] = Channel("seed", impairments)
    arrived = []
    step_s = every_s / 10.0
    for tick in range(count * 10 + 200):
        now_s = tick * step_s
        if tick % 10 == 0 and tick < count * 10:
            channel.push(tick // 10, size, now_s)
        arrived += [(now_s, number) for number in channel.pop(now_s)]
    return arrived


def test_a_perfect_link_delivers_at_once_and_in_order() -> None:
    channel: Channel[int] = Channel("seed")
    for number in range(3):
        channel.push(number, 100, 5.0)
    assert channel.pop(5.0) == [0, 1, 2]


@pytest.mark.parametrize("burst", [1.0, 4.0])
def test_loss_has_its_share_and_its_burst_length(burst: float) -> None:
    channel: Channel[int] = Channel("seed", Impairments(loss=0.2, burst=burst))
    for number in range(N):
        channel.push(number, 100, float(number))
    arrived = set(channel.pop(float(N)))
    lost = [number for number in range(N) if number not in arrived]
    bursts = len(lost) - sum(after == before + 1 for before, after in pairwise(lost))
    assert len(lost) / N == pytest.approx(0.2, abs=0.02)
    assert len(lost) / bursts == pytest.approx(max(burst, 1.25), rel=0.1)  # 1 / 0.8 in a row by chance alone


def test_latency_and_jitter_bound_the_delay_and_keep_the_order() -> None:
    arrived = carry(Impairments(latency_s=0.2, jitter_s=0.3), 300)
    delays = [at - 0.1 * number for at, number in arrived]
    assert 0.2 <= min(delays) < 0.25
    assert 0.45 < max(delays) <= 0.52
    assert [number for _, number in arrived] == list(range(300))


def test_reordering_lets_later_ones_overtake() -> None:
    numbers = [number for _, number in carry(Impairments(reordering=0.2, reordering_s=0.25), 300)]
    assert sorted(numbers) == list(range(300))
    assert 30 < sum(after < before for before, after in pairwise(numbers)) < 90


def test_duplicates_come_twice() -> None:
    numbers = [number for _, number in carry(Impairments(duplication=0.5), 400)]
    assert 540 < len(numbers) < 660
    assert set(numbers) == set(range(400))


def test_a_narrow_band_delays_and_then_drops() -> None:
    at_once = Impairments(bandwidth_bps=8_000.0)  # ten datagrams of 100 bytes a second
    assert [at - 0.1 * number for at, number in carry(at_once, 20)] == [pytest.approx(0.1, abs=0.011)] * 20
    channel: Channel[int] = Channel("seed", at_once)
    for number in range(50):
        channel.push(number, 100, 0.0)
    assert len(channel.pop(10.0)) == 11
    assert channel.lost == 39


def test_a_cut_lets_nothing_pass() -> None:
    assert carry(Impairments(cut=True), 50) == []


@given(
    loss=st.floats(0.0, 0.9),
    burst=st.floats(1.0, 8.0),
    jitter=st.floats(0.0, 0.5),
    duplication=st.floats(0.0, 1.0),
    reordering=st.floats(0.0, 1.0),
)
def test_the_same_seed_gives_the_same_fate(**values: float) -> None:
    rule = Impairments(
        loss=values["loss"],
        burst=values["burst"],
        jitter_s=values["jitter"],
        duplication=values["duplication"],
        reordering=values["reordering"],
    )
    assert carry(rule, 40) == carry(rule, 40)


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"loss": 1.5}, "loss must be between 0 and 1, got 1.5"),
        ({"burst": 0.5}, "burst must be between 1 and"),
        ({"latency_s": -1.0}, "latency_s must be between 0 and 3600"),
        ({"bandwidth_bps": 0.0}, "bandwidth_bps must be between 1 and"),
    ],
)
def test_an_impossible_impairment_is_refused(values: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        Impairments(**values)


def test_impairments_are_written_with_their_direction() -> None:
    fault, at_s, at_slot = parse_fault("impair:2@slot=7,up.loss=0.2,up.burst=3,down.cut=yes,for_s=20")
    assert (at_s, at_slot) == (None, 7)
    assert getattr(fault, "up", None) == Impairments(loss=0.2, burst=3)
    assert getattr(fault, "down", None) == Impairments(cut=True)
