"""sim.ftp and sim.metadata"""

import json
import struct
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.sim.ftp import ACK, BURST, CRC, LIST, NAK, OPEN, READ, TERMINATE, FileServer, Request, crc32
from skyfolio.sim.metadata import COMPONENT_METADATA, GENERAL, PARAMETERS

if TYPE_CHECKING:
    from tests.sim.conftest import Bench, GroundStation

CONTENT = bytes(range(256)) * 3


def ask(
    server: FileServer, gcs: "GroundStation", opcode: int, data: bytes = b"", offset: int = 0, size: int = 0
) -> Any:
    payload = struct.pack("<HBBBBBBI", 5, 0, opcode, size or len(data), 0, 0, 0, offset) + data
    message = gcs.message("file_transfer_protocol", 0, 1, 1, list(payload.ljust(251, b"\0")))
    return [Request.unpack(bytes(answer.payload)) for answer in server.handle(message)]


@pytest.fixture
def server() -> FileServer:
    return FileServer({"/logs/one.bin": CONTENT, "/two.txt": b"2"})


def test_a_file_is_opened_read_piece_by_piece_and_closed(server: FileServer, gcs: "GroundStation") -> None:
    (opened,) = ask(server, gcs, OPEN, b"logs/one.bin")
    assert (opened.opcode, opened.data) == (ACK, struct.pack("<I", len(CONTENT)))
    content = b""
    while True:
        (answer,) = ask(server, gcs, READ, offset=len(content), size=239)
        if answer.opcode == NAK:
            assert answer.data == b"\x06"
            break
        content += answer.data
    assert content == CONTENT
    ask(server, gcs, TERMINATE)
    assert ask(server, gcs, READ, size=10)[0].data == b"\x04"


def test_a_burst_sends_the_whole_file_and_marks_its_end(server: FileServer, gcs: "GroundStation") -> None:
    ask(server, gcs, OPEN, b"/logs/one.bin")
    answers = ask(server, gcs, BURST, size=100)
    assert b"".join(answer.data for answer in answers) == CONTENT
    assert [answer.seq for answer in answers] == list(range(6, 6 + len(answers)))
    assert [answer.complete for answer in answers] == [0] * (len(answers) - 1) + [1]


def test_what_is_not_there_or_not_for_reading_is_refused(server: FileServer, gcs: "GroundStation") -> None:
    assert ask(server, gcs, OPEN, b"nothing")[0].data == b"\x0a"
    assert ask(server, gcs, 7, b"two.txt")[0].opcode == NAK
    assert ask(server, gcs, LIST, b"/")[0].data.startswith(b"Flogs/one.bin\t768\0Ftwo.txt\t1")


def test_the_crc_is_that_of_mavlink(server: FileServer, gcs: "GroundStation") -> None:
    (answer,) = ask(server, gcs, CRC, b"two.txt")
    assert struct.unpack("<I", answer.data) == (crc32(b"2"),)
    assert crc32(b"") == 0


@given(payload=st.binary(min_size=251, max_size=251))
def test_no_payload_breaks_it(payload: bytes) -> None:
    server = FileServer({"two.txt": b"2"})
    message = dialect.MAVLink_file_transfer_protocol_message(0, 1, 1, list(payload))
    mav = dialect.MAVLink(None, srcSystem=245, srcComponent=190)
    message.pack(mav)
    for answer in server.handle(message):
        answer.pack(mav)


def test_px4_names_a_file_that_names_the_parameters_file(bench: "Bench", copter: "Bench") -> None:
    message: Any = bench.autopilot.telemetry.build(COMPONENT_METADATA)
    assert message.values[2].decode() == f"mftp://{GENERAL}"
    files = bench.autopilot.files
    (parameters,) = json.loads(files[GENERAL])["metadataTypes"]
    assert parameters["fileCrc"] == crc32(files[PARAMETERS])
    assert copter.autopilot.telemetry.build(COMPONENT_METADATA) is None
