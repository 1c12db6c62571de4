from collections.abc import Iterator
from typing import Any

import pytest
from fastapi.testclient import TestClient

from api.app import create_app
from api.settings import Settings
from planner import EXAMPLES


@pytest.fixture(scope="session")
def client() -> Iterator[TestClient]:
    """The service without any vehicle: nothing listens for a fleet until one is registered."""
    with TestClient(create_app(Settings(queue_limit=4)), raise_server_exceptions=False) as made:
        yield made


@pytest.fixture
def minimal() -> dict[str, Any]:
    made: dict[str, Any] = EXAMPLES["minimal"]().model_dump(mode="json")
    return made


@pytest.fixture
def paper() -> dict[str, Any]:
    made: dict[str, Any] = EXAMPLES["paper"]().model_dump(mode="json")
    return made
