"""sim.wire"""

from typing import TYPE_CHECKING

from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.sim.wire import Decoder, Encoder, Extended, text

if TYPE_CHECKING:
    from tests.sim.conftest import GroundStation


def test_extension_fields_ride_behind_the_known_ones() -> None:
    message = Extended(dialect.MAVLink_mission_current_message(3, 7, 3, 1), mission_id=0x01020304)
    frame = Encoder(1).encode(message)
    (seen,) = Decoder().decode(frame)
    assert (seen.seq, seen.total, seen.mission_state, seen.mission_mode) == (3, 7, 3, 1)
    assert frame[10:-2] == bytes([3, 0, 7, 0, 3, 1, 4, 3, 2, 1])
    assert (message.mission_id, message.seq, message.get_type()) == (0x01020304, 3, "MISSION_CURRENT")


def test_frames_are_numbered() -> None:
    encoder = Encoder(9)
    frames = [encoder.encode(text("hello")) for _ in range(257)]
    assert [frame[4] for frame in frames] == [n % 256 for n in range(257)]
    assert frames[0][5:7] == bytes([9, 1])


@given(
    velocity=st.tuples(*[st.integers(-(2**15), 2**15 - 1)] * 3),
    seq=st.integers(0, 255),
    checksum=st.integers(0, 2**32 - 1),
)
def test_frames_are_those_that_pymavlink_packs(velocity: tuple[int, int, int], seq: int, checksum: int) -> None:
    messages = [
        dialect.MAVLink_global_position_int_message(1, 2, 3, 4, 0, *velocity, 0),
        dialect.MAVLink_ping_message(0, 0, 0, 0),
        dialect.MAVLink_mission_item_reached_message(seq),
        dialect.MAVLink_battery_status_message(0, 1, 1, 0x7FFF, [3900] * 4 + [0xFFFF] * 6, 10, 20, -1, 90),
        Extended(dialect.MAVLink_mission_current_message(3, 9, 2, 1), mission_id=checksum),
        text("hello"),
    ]
    for message in messages:
        mav, encoder = dialect.MAVLink(None, 9, 1), Encoder(9)
        mav.seq = encoder._mav.seq = seq
        assert encoder.encode(message) == bytes(message.pack(mav))


def test_damaged_and_mavlink_1_frames_are_dropped_and_the_next_is_still_decoded(gcs: "GroundStation") -> None:
    good = gcs.frame("ping", 1, 2, 0, 0)
    damaged = bytearray(good)
    damaged[12] ^= 0xFF
    old = dialect.MAVLink_ping_message(1, 2, 0, 0).pack(dialect.MAVLink(None, 245, 190), force_mavlink1=True)
    decoder = Decoder()
    assert decoder.decode(bytes(damaged)) == []
    assert decoder.decode(old) == []
    assert decoder.decode(b"noise") == []
    assert [message.get_type() for message in decoder.decode(good + good)] == ["PING", "PING"]


def test_a_text_is_cut_at_fifty_bytes() -> None:
    (message,) = Decoder().decode(Encoder(1).encode(text("x" * 80)))
    assert message.text == "x" * 50


@given(pieces=st.lists(st.one_of(st.binary(max_size=60), st.binary(max_size=20).map(b"\xfd".__add__)), max_size=8))
def test_no_noise_breaks_the_decoder(pieces: list[bytes]) -> None:
    decoder = Decoder()
    for piece in pieces:
        decoder.decode(piece)
