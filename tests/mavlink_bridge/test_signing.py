"""MAVLink 2 signing: what is let in, what is not, and the flaw of pymavlink that must not be ours."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.mavlink_bridge import LinkOptions, Signing, compile_mission
from skyfolio.mavlink_bridge.errors import SigningKeyInvalid
from skyfolio.mavlink_bridge.framing import Frame, Framer
from skyfolio.planner.plans import Plan

KEY, OTHER = bytes(range(32)), bytes(range(1, 33))
NOW_S = 1_800_000_000.0
FAR_FUTURE = 2**47


def signed(seconds: float = 0.0, *, key: bytes = KEY, message: Any = None, timestamp: int | None = None) -> bytes:
    """A frame of vehicle 1 as pymavlink signs it."""
    mav = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
    mav.signing.secret_key, mav.signing.sign_outgoing, mav.signing.link_id = key, True, 3
    mav.signing.timestamp = timestamp or int((NOW_S + seconds - 1420070400) * 1e5)
    return bytes((message or dialect.MAVLink_heartbeat_message(2, 12, 81, 0, 4, 3)).pack(mav))


def plain(message: Any = None) -> bytes:
    return bytes((message or dialect.MAVLink_heartbeat_message(2, 12, 81, 0, 4, 3)).pack(dialect.MAVLink(None, 1, 1)))


def frame(data: bytes) -> Frame:
    (only,) = Framer().feed(data)
    return only


def ours() -> Signing:
    return Signing(KEY, wall_s=lambda: NOW_S)


def test_a_genuine_frame_comes_in_without_its_signature() -> None:
    assert ours().accept(frame(signed())) == plain()


@given(command=st.integers(0, 65535), value=st.floats(-1e6, 1e6, width=32))
def test_what_we_sign_pymavlink_takes_for_genuine(command: int, value: float) -> None:
    message = dialect.MAVLink_command_long_message(1, 1, command, 0, value, 0, 0, 0, 0, 0, 0)
    sent = ours().sign(bytes(message.pack(dialect.MAVLink(None, 245, 190))))
    vehicle = dialect.MAVLink(None)
    vehicle.signing.secret_key = KEY
    (read,) = vehicle.parse_buffer(sent)
    assert (read.get_signed(), read.command, read.param1) == (True, command, value)


@pytest.mark.parametrize(
    "data",
    [plain(), signed(key=OTHER), signed()[:-1] + b"\0", signed(-120.0)],
    ids=["unsigned", "other key", "damaged signature", "two minutes old"],
)
def test_anything_else_is_dropped_and_counted(data: bytes) -> None:
    signing = ours()
    assert signing.accept(frame(data)) is None
    assert signing.refused == 1


def test_mavlink_1_is_dropped() -> None:
    old = dialect.MAVLink(None, 1, 1)
    data = bytes(dialect.MAVLink_heartbeat_message(2, 12, 81, 0, 4, 3).pack(old, force_mavlink1=True))
    assert frame(data).version == 1
    assert ours().accept(frame(data)) is None


def test_a_frame_that_was_heard_before_is_dropped() -> None:
    signing = ours()
    assert signing.accept(frame(signed(1.0))) is not None
    assert signing.accept(frame(signed(1.0))) is None
    assert signing.accept(frame(signed(0.5))) is None
    assert signing.accept(frame(signed(1.5))) is not None


def test_a_forged_frame_from_the_far_future_shuts_nobody_out() -> None:
    signing = ours()
    assert signing.accept(frame(signed())) is not None
    forged = frame(signed(key=OTHER, timestamp=FAR_FUTURE))
    assert signing.accept(forged) is None
    assert signing.accept(frame(signed(1.0))) is not None


def test_pymavlinks_own_check_has_that_flaw() -> None:
    """Should this fail, pymavlink has been mended, and our own check may go."""
    theirs = dialect.MAVLink(None)
    theirs.signing.secret_key = KEY
    theirs.robust_parsing = True
    assert theirs.parse_buffer(signed())[0].get_type() == "HEARTBEAT"
    theirs.parse_buffer(signed(key=OTHER, timestamp=FAR_FUTURE))
    assert theirs.parse_buffer(signed(1.0))[0].get_type() == "BAD_DATA"


def test_our_timestamps_rise_even_if_the_clock_stands_still() -> None:
    signing = ours()
    stamps = [int.from_bytes(signing.sign(plain())[-12:-6], "little") for _ in range(5)]
    assert stamps == sorted(set(stamps))


def test_keys_come_from_files_and_are_never_shown(tmp_path: Path) -> None:
    (tmp_path / "raw").write_bytes(KEY)
    (tmp_path / "hex").write_text(KEY.hex() + "\n", encoding="utf-8")
    (tmp_path / "short").write_text("secret-text", encoding="utf-8")
    for name in ("raw", "hex"):
        assert frame(Signing.from_file(tmp_path / name).sign(plain())).signed
    for name in ("short", "missing"):
        with pytest.raises(SigningKeyInvalid) as caught:
            Signing.from_file(tmp_path / name)
        assert "secret-text" not in str(caught.value)
    with pytest.raises(SigningKeyInvalid, match="5 bytes, must be 32"):
        Signing(b"short")


async def test_a_signed_fleet_is_flown_and_an_unsigned_one_is_not_heard(
    airfield: Callable[..., Any], line_and_hover: Plan
) -> None:
    options = LinkOptions(signing=Signing(KEY))
    async with airfield(line_and_hover, options=options, signing_key=KEY) as field:
        (result,) = (await field.link.upload({1: compile_mission(line_and_hover, "uav-1")})).values()
        assert result.verified, result.error
    with pytest.raises(Exception, match="no autopilot heartbeat from system 1"):
        async with airfield(line_and_hover, options=LinkOptions(signing=Signing(KEY)), wait_s=1.0):
            pass
