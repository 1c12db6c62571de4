"""sim.link"""

from typing import TYPE_CHECKING, Any

import pytest

from skyfolio.sim.link import MAX_PEERS, DatagramLink, Radio, endpoints_of

if TYPE_CHECKING:
    from tests.sim.conftest import GroundStation


class Transport:
    """Keeps what would be sent."""

    def __init__(self) -> None:
        self.sent: list[Any] = []

    def sendto(self, data: bytes, address: Any) -> None:
        """Keep a datagram."""
        self.sent.append((data, address))

    def abort(self) -> None:
        """Do nothing more."""


def a_link() -> tuple[DatagramLink, Transport, list[Any]]:
    heard: list[Any] = []
    link, transport = (
        DatagramLink([("gcs", 1)], Radio("0", lambda: 0.0), lambda message, sender: heard.append((message, sender))),
        Transport(),
    )
    link.connection_made(transport)  # type: ignore[arg-type]
    return link, transport, heard


def test_one_port_serves_all_and_a_range_gives_each_its_own() -> None:
    assert endpoints_of("udpout://127.0.0.1:14540", 2) == [[("127.0.0.1", 14540)]] * 2
    assert endpoints_of("udpout://host.local:14541-14543", 2) == [[("host.local", 14541)], [("host.local", 14542)]]
    assert endpoints_of("udpout://[::1]:14540", 1) == [[("::1", 14540)]]


@pytest.mark.parametrize(
    "url",
    ["", "127.0.0.1:14540", "udpin://127.0.0.1:1", "udpout://h", "udpout://h:0", "udpout://h:9-8", "udpout://h:1-2"],
)
def test_an_endpoint_that_cannot_be_is_refused(url: str) -> None:
    with pytest.raises(ValueError, match="endpoint"):
        endpoints_of(url, 3)


def test_each_peer_has_a_parser_of_its_own(gcs: "GroundStation") -> None:
    link, _, heard = a_link()
    frame = gcs.frame("ping", 1, 2, 0, 0)
    link.datagram_received(frame + frame[:9], ("a", 1))
    link.datagram_received(frame, ("b", 1))
    link.datagram_received(frame[9:], ("a", 1))
    assert [sender for _, sender in heard] == [("a", 1), ("b", 1), ("a", 1)]


def test_telemetry_goes_to_the_endpoint_and_to_peers_that_spoke_mavlink(gcs: "GroundStation") -> None:
    link, transport, _ = a_link()
    link.datagram_received(b"noise", ("stranger", 1))
    link.datagram_received(gcs.frame("ping", 1, 2, 0, 0), ("friend", 1))
    link.datagram_received(gcs.frame("ping", 1, 2, 0, 0), ("gcs", 1))
    link.broadcast(b"data")
    assert transport.sent == [(b"data", ("gcs", 1)), (b"data", ("friend", 1))]


def test_a_crowd_of_peers_is_bounded(gcs: "GroundStation") -> None:
    link, transport, _ = a_link()
    for port in range(50):
        link.datagram_received(gcs.frame("ping", 1, 2, 0, 0), ("peer", port))
    link.broadcast(b"data")
    assert len(transport.sent) == MAX_PEERS + 1


def test_a_closed_link_neither_sends_nor_receives(gcs: "GroundStation") -> None:
    link, transport, heard = a_link()
    link.close()
    link.broadcast(b"data")
    link.datagram_received(gcs.frame("ping", 1, 2, 0, 0), ("a", 1))
    link.error_received(OSError())
    assert (transport.sent, heard, link.is_open) == ([], [], False)
