"""The guard of a stream: its orders, its pipe, and whom it leaves the links to."""

from __future__ import annotations

import asyncio
import json
from dataclasses import asdict

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skyfolio.mavlink_bridge import ConnectionFailed, GuardFailed, guard
from skyfolio.mavlink_bridge.guard import Guard, Orders, last_of, take_over

ITEMS = st.lists(st.integers(0, 200), min_size=1, max_size=30).map(tuple)


def orders(**changes: object) -> Orders:
    wanted = {"links": ("udpin://127.0.0.1:14540",), "slot0_at": 1000.0, "scale": 2.0, "slot_s": 5.0}
    return Orders(**{**wanted, "items": {7: (1, 3, 5, 7)}, **changes})  # type: ignore[arg-type]


@given(
    items=st.dictionaries(st.integers(1, 250), ITEMS, min_size=1, max_size=5),
    scale=st.floats(0.1, 100),
    slot_s=st.floats(0.5, 60),
    key=st.none() | st.text(max_size=20),
)
def test_orders_come_out_of_the_pipe_as_they_went_in(
    items: dict[int, tuple[int, ...]], scale: float, slot_s: float, key: str | None
) -> None:
    given_orders = orders(items=items, scale=scale, slot_s=slot_s, signing_key_file=key)
    assert Orders.of_line(given_orders.line()) == given_orders


@pytest.mark.parametrize(("now", "item"), [(990.0, 1), (1000.0, 3), (1002.4, 3), (1002.6, 5), (1005.1, 7), (1099.0, 7)])
def test_the_waypoint_is_that_of_the_slot_that_begins_next(now: float, item: int) -> None:
    assert orders().item_at(7, now) == item


def test_the_last_whole_orders_count() -> None:
    first, second = orders(), orders(slot0_at=2000.0)
    assert last_of([first.line(), second.line()]) == second
    assert last_of([first.line(), second.line()[:40]]) == first, "killed while it wrote"
    assert last_of([first.line(), b"null\n"]) is None
    assert last_of([]) is None


def test_a_guard_sends_nothing_once_another_service_may_command_the_vehicles() -> None:
    assert orders().are_valid(60.0)
    assert orders(until_s=60.0).are_valid(59.9)
    assert not orders(until_s=60.0).are_valid(60.0)
    assert Orders.of_line(orders(until_s=60.0).line()) == orders(until_s=60.0)


def test_no_secret_goes_through_the_pipe() -> None:
    assert set(json.loads(orders(signing_key_file="/etc/key").line())) == set(asdict(orders()))
    assert json.loads(orders(signing_key_file="/etc/key").line())["signing_key_file"] == "/etc/key"


async def test_a_guard_that_is_dismissed_touches_no_link(free_port: int) -> None:
    heard = []

    class Port(asyncio.DatagramProtocol):
        def datagram_received(self, data: bytes, _addr: object) -> None:
            heard.append(data)

    transport, _ = await asyncio.get_running_loop().create_datagram_endpoint(Port, ("127.0.0.1", free_port))
    watching = Guard()
    await watching.start()
    watching.orders(orders(links=(f"udpout://127.0.0.1:{free_port}",)))
    await watching.close()
    transport.close()
    assert heard == []
    with pytest.raises(GuardFailed):
        watching.orders(None)


async def test_links_that_somebody_else_has_are_left_to_them(free_port: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(guard, "LINKS_FREE_S", 0.2)
    loop = asyncio.get_running_loop()
    transport, _ = await loop.create_datagram_endpoint(asyncio.DatagramProtocol, ("127.0.0.1", free_port))
    with pytest.raises(ConnectionFailed):
        await take_over(orders(links=(f"udpin://127.0.0.1:{free_port}",)))
    transport.close()


async def test_a_vehicle_that_is_not_heard_is_named(free_port: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(guard, "HEARD_S", 0.2)
    said = await take_over(orders(links=(f"udpin://127.0.0.1:{free_port}",)))
    assert said == {7: "not heard within 0.2 s"}
