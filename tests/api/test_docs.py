"""`docs/api.md` is a session that works: every shell block is run, in order, against a real service."""

import re
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import httpx2
import pytest

from tests.ports import free_port

pytestmark = pytest.mark.e2e
PAGE = Path(__file__).resolve().parents[2] / "docs" / "api.md"


@pytest.fixture
def api(tmp_path: Path) -> Iterator[str]:
    """The service that the page starts."""
    [command] = re.findall(r"^skyfolio (serve --simulate .*)$", PAGE.read_text(), flags=re.MULTILINE)
    port = free_port(socket.SOCK_STREAM)
    more = ["--port", str(port), "--database-url", f"sqlite+aiosqlite:///{tmp_path}/service.db", "--json"]
    with (tmp_path / "service.log").open("wb") as log:
        process = subprocess.Popen([sys.executable, "-m", "skyfolio", *command.split(), *more], stdout=log, stderr=log)
        try:
            url = f"http://127.0.0.1:{port}"
            deadline = time.monotonic() + 150
            while True:
                assert process.poll() is None, (tmp_path / "service.log").read_text()
                assert time.monotonic() < deadline
                try:
                    if httpx2.get(f"{url}/ready", timeout=120).status_code == 200:
                        break
                except httpx2.TransportError:
                    pass
                time.sleep(0.1)
            yield url
        finally:
            process.terminate()
            process.wait()


@pytest.mark.long
def test_the_session_of_the_api_page_works(api: str, tmp_path: Path) -> None:
    blocks = re.findall(r"^```sh\n(.*?)^```$", PAGE.read_text(), flags=re.MULTILINE | re.DOTALL)
    assert len(blocks) >= 8
    script = "set -euo pipefail\n" + "\n".join(blocks)
    done = subprocess.run(
        ["bash", "-c", script],
        cwd=tmp_path,
        env={"SKYFOLIO_API": api, "PATH": "/usr/bin:/bin:/usr/local/bin"},
        capture_output=True,
        text=True,
        timeout=200,
    )
    said = done.stdout.splitlines()
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    for line in ("3", "8", "QGC WPL 110", "succeeded", "live", "scheduled", "flying", "4", "aborted"):
        assert line in said, (line, said)
    assert {"bound derivative resolve", "True", "12"} <= set(said)
    assert any(line.startswith("6 losses user-") for line in said)
    steps = "detected classified replanned checked uploading uploading verified verified flying closed"
    assert steps in said
    assert 'skyfolio_replans_total{cause="heartbeat_lost",outcome="flying"} 1.0' in said
