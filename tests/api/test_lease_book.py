"""Leases in virtual time: whatever is slow, stopped or cut off, no two services may send to one vehicle."""

from __future__ import annotations

from dataclasses import dataclass, field

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from skyfolio.api.store.lease_book import DEAF_S, EVERYBODY, NOBODY, Lease, LeaseBook

TERM_S, MARGIN_S = 2.5, 0.5
SYSTEMS = frozenset({1, 2})


def row(owner: str = "a", token: int = 1, beat: int = 0, *, renewed: bool = False) -> Lease:
    return Lease(operation_id="op", owner=owner, name=owner, token=token, beat=beat, systems=SYSTEMS, renewed=renewed)


def a_book(me: str = "a") -> LeaseBook:
    return LeaseBook(me, term_s=TERM_S, margin_s=MARGIN_S)


def test_a_lease_runs_out_a_term_after_its_renewal_was_asked_for_not_after_it_was_granted() -> None:
    book = a_book()
    book.hold("op", 1, SYSTEMS, began_s=10.0, ended_s=11.0)
    book.take_in([row(renewed=True)], began_s=11.5, ended_s=13.0)
    assert book.may_send(1, 13.9)
    assert not book.may_send(1, 14.0)
    assert book.take_lapsed(13.9) == []
    assert book.take_lapsed(14.0) == ["op"]
    assert not book.may_send(1, 14.0), "it is let go of, and its row still names the vehicles"


def test_a_late_renewal_counts_unless_it_was_let_go_of_before() -> None:
    book = a_book()
    book.hold("op", 1, SYSTEMS, began_s=0.0, ended_s=0.1)
    book.take_in([row(renewed=True)], began_s=1.0, ended_s=3.0)
    assert book.may_send(1, 3.0)
    assert book.take_lapsed(4.0) == ["op"]
    book.take_in([row(renewed=True)], began_s=3.9, ended_s=4.1)
    assert not book.may_send(1, 4.1)


def test_a_lease_with_another_token_is_lost_at_once() -> None:
    book = a_book()
    book.hold("op", 1, SYSTEMS, began_s=0.0, ended_s=0.0)
    book.take_in([row("b", token=2)], began_s=0.5, ended_s=0.6)
    assert not book.may_send(1, 0.6)
    assert book.take_lapsed(0.6) == ["op"]
    owner = book.owner_of("op")
    assert owner is not None
    assert owner.name == "b"


def test_a_look_that_was_begun_before_a_lease_was_granted_says_nothing_about_it() -> None:
    book = a_book()
    book.hold("op", 1, SYSTEMS, began_s=1.0, ended_s=1.2)
    book.take_in([], began_s=1.1, ended_s=1.5)
    assert book.may_send(1, 1.5)


def test_a_beat_that_stands_still_for_a_term_and_the_margin_may_be_taken_over_and_one_that_moves_may_not() -> None:
    book = a_book("b")
    for tenth in range(100):
        book.take_in([row(beat=tenth // 20)], tenth / 10, tenth / 10)
        assert book.takeable(tenth / 10) == []
    stood_still_s = 8.0  # when the last beat, 4, was first seen
    book.take_in([row(beat=4)], 10.9, 10.9)
    assert book.takeable(stood_still_s + TERM_S + MARGIN_S - 0.05) == []
    assert book.takeable(stood_still_s + TERM_S + MARGIN_S) != []
    assert book.takeable(stood_still_s + TERM_S + MARGIN_S, deaf_to=["op"]) == []
    assert book.takeable(stood_still_s + TERM_S + MARGIN_S + DEAF_S, deaf_to=["op"]) != []


def test_a_lease_that_was_given_up_may_be_taken_at_once() -> None:
    book = a_book("b")
    book.take_in([row(NOBODY)], 0.0, 0.1)
    assert [lease.operation_id for lease in book.takeable(0.1)] == ["op"]


def test_a_vehicle_of_nobody_may_be_sent_to_only_while_that_is_known() -> None:
    book = a_book()
    assert not book.may_send(7, 0.0)
    assert not book.may_send(EVERYBODY, 0.0)
    book.take_in([row("b")], 1.0, 1.1)
    assert book.may_send(7, 1.1)
    assert not book.may_send(1, 1.1)
    assert not book.may_send(7, 1.0 + TERM_S)
    assert not book.may_send(EVERYBODY, 1.0 + TERM_S)


# -- any history ------------------------------------------------------------------------------------------------------


@dataclass
class Table:
    """The row as the database has it."""

    owner: str = "a"
    token: int = 1
    beat: int = 0

    def look(self, me: str, *, holds: bool) -> list[Lease]:
        renewed = holds and self.owner == me
        found = row(self.owner, self.token, self.beat, renewed=renewed)
        self.beat += renewed
        return [found]

    def take(self, me: str, seen: Lease) -> int | None:
        if (seen.owner, seen.token, seen.beat) != (self.owner, self.token, self.beat):
            return None
        self.owner, self.token, self.beat = me, self.token + 1, 0
        return self.token


@dataclass
class Asked:
    """A question on its way to the database, or an answer on its way back."""

    began_s: float
    reaches_s: float
    returns_s: float
    wanted: Lease | None = None
    rows: list[Lease] | None = None
    token: int | None = None
    done: bool = False


@dataclass
class Process:
    """One service: it asks at its own pace, may be stopped at any moment, and hears late or never from the database."""

    book: LeaseBook
    asked: list[Asked] = field(default_factory=list)
    stopped_until_s: float = 0.0

    def step(self, table: Table, now_s: float, there_s: float, back_s: float) -> None:
        for one in self.asked:  # the database works whether the process is stopped or not
            if not one.done and now_s >= one.reaches_s:
                one.done = True
                if one.wanted is None:
                    one.rows = table.look(self.book.me, holds="op" in self.book.held)
                else:
                    one.token = table.take(self.book.me, one.wanted)
        if now_s < self.stopped_until_s:
            return
        for one in [each for each in self.asked if each.done and now_s >= each.returns_s]:
            self.asked.remove(one)
            if one.rows is not None:
                self.book.take_in(one.rows, one.began_s, now_s)
            elif one.token is not None:
                self.book.hold("op", one.token, SYSTEMS, one.began_s, now_s)
        self.book.take_lapsed(now_s)
        if self.asked:
            return
        takeable = self.book.takeable(now_s)
        wanted = takeable[0] if takeable else None
        self.asked.append(Asked(now_s, now_s + there_s, now_s + there_s + back_s, wanted))


STEP = st.tuples(
    st.sampled_from([0.0, 0.0, 0.1, 0.6, 3.0]),  # the way there
    st.sampled_from([0.0, 0.0, 0.1, 0.6, 3.0]),  # the way back
    st.sampled_from([0.0] * 12 + [1.0, 2.9, 4.0, 9.0]),  # how long the process is stopped
)


@given(steps=st.lists(st.tuples(STEP, STEP, STEP), min_size=50, max_size=300))
@settings(deadline=None, suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large], max_examples=60)
def test_no_two_services_may_ever_send_to_one_vehicle(steps: list[tuple[tuple[float, ...], ...]]) -> None:
    table, services = Table(), [Process(a_book(name)) for name in "abc"]
    services[0].book.hold("op", 1, SYSTEMS, 0.0, 0.0)
    for number, step in enumerate(steps):
        now_s = number * 0.1
        for service, (there_s, back_s, stop_s) in zip(services, step, strict=True):
            if stop_s:
                service.stopped_until_s = max(service.stopped_until_s, now_s + stop_s)
            service.step(table, now_s, there_s, back_s)
        sending = [service.book.me for service in services if service.book.may_send(1, now_s)]
        assert len(sending) <= 1, f"{sending} at {now_s:.1f} s"
        assert sending in ([], [table.owner])


def test_an_owner_that_answers_within_half_a_term_keeps_its_lease_and_one_that_dies_is_followed_within_4_s() -> None:
    table, first, second = Table(), Process(a_book("a")), Process(a_book("b"))
    first.book.hold("op", 1, SYSTEMS, 0.0, 0.0)
    died_s, taken_s = 20.0, None
    for hundredth in range(4_000):
        now_s = hundredth / 100
        if now_s < died_s:
            first.step(table, now_s, 0.6, 0.6)
            assert first.book.may_send(1, now_s)
            assert table.owner == "a"
        second.step(table, now_s, 0.01, 0.01)
        if taken_s is None and second.book.may_send(1, now_s):
            taken_s = now_s
    assert taken_s is not None
    assert taken_s - died_s < 4.0
