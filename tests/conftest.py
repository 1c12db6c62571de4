"""What all tests share."""

import os
import socket

import pytest
from hypothesis import settings

from skyfolio import api  # noqa: F401 - first of all, so that kernels are where set-up has compiled them
from tests import ports

os.environ.setdefault("SKYFOLIO_ALLOWED_HOSTS", "testserver")  # the name under which Starlette's TestClient asks
settings.register_profile("skyfolio", deadline=None)  # a shared machine may be slow; time is measured in benchmarks
settings.load_profile("skyfolio")


@pytest.fixture
def free_port() -> int:
    """A UDP port nobody uses."""
    return ports.free_port(socket.SOCK_DGRAM)
