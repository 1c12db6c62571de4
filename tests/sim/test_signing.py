"""sim.signing: who holds the key is heard, and a forger shuts nobody out"""

from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.sim import Fleet, VirtualClock, grid_of
from skyfolio.sim.clock import EPOCH_S
from skyfolio.sim.signing import Signature
from skyfolio.sim.wire import Decoder, Encoder

KEY, OTHER = b"k" * 32, b"o" * 32
HOME = (47.397742, 8.545594)
BEAT = dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)


def signed(key: bytes, at_s: float = EPOCH_S) -> Encoder:
    return Encoder(245, Signature(key, lambda: at_s))


def listener() -> Decoder:
    return Decoder(Signature(KEY, lambda: EPOCH_S))


def test_only_frames_with_the_key_are_accepted() -> None:
    decoder = listener()
    assert len(decoder.decode(signed(KEY).encode(BEAT))) == 1
    assert decoder.decode(signed(OTHER).encode(BEAT)) == []
    assert decoder.decode(Encoder(245).encode(BEAT)) == []


def test_a_frame_is_not_accepted_twice() -> None:
    decoder = listener()
    frame = signed(KEY).encode(BEAT)
    assert len(decoder.decode(frame)) == 1
    assert decoder.decode(frame) == []


def test_a_forged_frame_from_the_future_shuts_no_later_frame_out() -> None:
    decoder, genuine = listener(), signed(KEY)
    assert len(decoder.decode(genuine.encode(BEAT))) == 1
    assert decoder.decode(signed(OTHER, EPOCH_S + 1e6).encode(BEAT)) == []
    assert len(decoder.decode(genuine.encode(BEAT))) == 1


def test_a_fleet_with_a_key_signs_and_obeys_only_signed_messages() -> None:
    fleet = Fleet(grid_of(1, *HOME), clock=VirtualClock(), signing_key=KEY)
    heard: list[Any] = []
    decoder = listener()
    send = fleet.attach(lambda data, _: heard.extend(decoder.decode(data)))
    fleet.step_to(2.0)
    assert len({message.get_type() for message in heard}) > 5
    arm = dialect.MAVLink_command_long_message(1, 1, 400, 0, 1.0, *[0.0] * 6)
    send(Encoder(245).encode(arm), 1)
    assert not fleet.vehicles[1].armed
    send(signed(KEY, EPOCH_S + 2.0).encode(arm), 1)
    assert fleet.vehicles[1].autopilot.armed


def test_a_key_has_32_bytes() -> None:
    with pytest.raises(ValueError, match="must have 32 bytes, got 5"):
        Fleet(grid_of(1, *HOME), clock=VirtualClock(), signing_key=b"short")
