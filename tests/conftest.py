"""What all tests share."""

import os
import socket
from typing import Any

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


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the tests that take long, so that no worker is left alone with one of them at the end."""
    items.sort(key=lambda item: item.get_closest_marker("long") is None)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """With `--dist loadscope` a worker gets one test at a time; those of one browser stay together."""
    if config.getvalue("dist") != "loadscope":
        return None
    from xdist.scheduler import LoadScopeScheduling  # noqa: PLC0415 - not needed without workers

    made: Any = LoadScopeScheduling(config, log)
    made._split_scope = _together
    return made


def _together(nodeid: str) -> str:
    """What a worker gets as a whole."""
    return nodeid.partition("::")[0] if nodeid.startswith("tests/dashboard/") else nodeid
