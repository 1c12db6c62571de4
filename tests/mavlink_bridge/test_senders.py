"""Who may speak for a vehicle: a claim of an id moves only after a loss would be declared, and that is told."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skyfolio.mavlink_bridge.framing import Frame
from skyfolio.mavlink_bridge.senders import SenderKind, Senders

URL = "udpin://0.0.0.0:14540"
GENUINE, FORGER = ("10.0.0.1", 14550), ("10.0.0.66", 9999)


def frame(source: object, *, component: int = 1, signed: bool = False) -> Frame:
    return Frame(b"", 1, component, 0, 0, 2, signed, source)


@pytest.fixture
def senders() -> Senders:
    made = Senders(moves_after_s=6.0)
    assert made.accepts(URL, frame(GENUINE), 0.0)
    return made


def test_a_forger_is_not_believed_while_the_vehicle_is_silent_for_less_than_a_loss_takes(senders: Senders) -> None:
    assert [senders.accepts(URL, frame(FORGER), at) for at in (0.1, 3.1, 5.0, 6.0)] == [False] * 4
    (notice,) = senders.notices()
    assert notice.kind is SenderKind.CONTESTED
    assert (notice.before, notice.now) == ("10.0.0.1:14550", "10.0.0.66:9999")


def test_after_a_loss_a_vehicle_may_come_from_elsewhere_and_that_is_told(senders: Senders) -> None:
    assert senders.accepts(URL, frame(FORGER, signed=True), 6.1)
    assert not senders.accepts(URL, frame(GENUINE), 6.2)
    moved, contested = senders.notices()
    assert (moved.kind, moved.signed) == (SenderKind.MOVED, True)
    assert contested.kind is SenderKind.CONTESTED


def test_autopilot_and_companion_have_addresses_of_their_own(senders: Senders) -> None:
    for at in (0.5, 1.5, 2.5, 3.5):  # the autopilot's radio pauses, the companion's does not
        assert senders.accepts(URL, frame(("10.0.0.1", 14999), component=191), at)
    assert senders.accepts(URL, frame(GENUINE), 3.6)
    assert senders.notices() == []


def test_the_same_id_on_a_second_link_is_told_once(senders: Senders) -> None:
    for at in (0.1, 0.2, 0.3):
        assert senders.accepts("serial:///dev/radio:57600", frame(None), at)
    (notice,) = senders.notices()
    assert notice.kind is SenderKind.SECOND_LINK
    assert notice.now == "serial:///dev/radio:57600"


@given(st.lists(st.tuples(st.floats(0.0, 10.0), st.booleans()), max_size=60))
def test_two_addresses_are_never_believed_within_the_time_a_loss_takes(steps: list[tuple[float, bool]]) -> None:
    senders, now, believed = Senders(moves_after_s=6.0), 0.0, [(0.0, GENUINE)]
    senders.accepts(URL, frame(GENUINE), 0.0)
    for pause, forged in steps:
        now += pause
        source = FORGER if forged else GENUINE
        if senders.accepts(URL, frame(source), now):
            before, who = believed[-1]
            assert who == source or now - before > 6.0
            believed.append((now, source))
