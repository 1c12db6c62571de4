"""The record of a flight: what goes in comes out, and it is small."""

from hypothesis import given
from hypothesis import strategies as st

from skyfolio.api.flights.track import Track

UAVS = ("uav-1", "uav-2", "uav-3")
metres = st.floats(-1e5, 1e5)
heard = st.fixed_dictionaries({}, optional=dict.fromkeys(UAVS, st.tuples(metres, metres)))


@given(record=st.lists(st.tuples(st.floats(0, 1e5), heard), max_size=6), begin=st.integers(-7, 7))
def test_what_is_recorded_comes_back_as_it_was(
    record: list[tuple[float, dict[str, tuple[float, float]]]], begin: int
) -> None:
    track = Track(UAVS)
    for at, where in record:
        track.append(at, where)
    assert len(track) == len(record)
    assert list(track) == record
    assert track[begin:] == record[begin:]
    if record:
        assert track[-1] == record[-1]
        assert track.at_s(-1) == record[-1][0]


def test_a_sample_takes_sixteen_bytes_for_each_uav_and_eight_for_its_time() -> None:
    track = Track(UAVS)
    for number in range(1000):
        track.append(0.5 * number, dict.fromkeys(UAVS, (1.0, 2.0)))
    held = sum(len(part) * part.itemsize for part in (track._at_s, track._places_m))
    assert held == 1000 * (8 + 16 * len(UAVS))


def test_since_when_a_uav_is_where_it_was_last_heard_is_known() -> None:
    track = Track(UAVS)
    places = [(0.0, 0.0), (5.0, 0.0), (5.0, 0.0), (9.0, 0.0), (9.0, 0.0)]
    for number, place in enumerate(places):
        track.append(0.5 * number, {"uav-1": place} if number < 3 else {"uav-1": place, "uav-2": (1.0, 1.0)})
    assert [track.still_since_s(uav) for uav in UAVS] == [1.5, 1.5, None]
