import asyncio
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from fastapi.testclient import TestClient
from sqlalchemy import text
from sqlalchemy.ext.asyncio import create_async_engine

from skyfolio.api.common.settings import Settings
from skyfolio.api.http.app import create_app
from skyfolio.planner import EXAMPLES
from tests.api import postgres


@pytest.fixture(scope="session")
def client() -> Iterator[TestClient]:
    """The service without any vehicle: nothing listens for a fleet until one is registered."""
    with TestClient(create_app(Settings(queue_limit=4)), raise_server_exceptions=False) as made:
        yield made


@pytest.fixture(scope="session")
def postgres_server() -> Iterator[str]:
    if postgres.program("pg_ctl") is None:
        pytest.skip(postgres.MISSING)
    with postgres.server() as url:
        yield url


@pytest.fixture(params=["sqlite", "postgresql"])
def database_url(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """An empty database of each kind that the service supports."""
    if request.param == "sqlite":
        return f"sqlite+aiosqlite:///{tmp_path}/service.db"
    return str(request.getfixturevalue("new_database"))


@pytest.fixture
def new_database(postgres_server: str) -> str:
    """An empty PostgreSQL database."""
    name = f"test_{uuid.uuid4().hex}"
    asyncio.run(_create_database(f"{postgres_server}/postgres", name))
    return f"{postgres_server}/{name}"


async def _create_database(url: str, name: str) -> None:
    engine = create_async_engine(url, isolation_level="AUTOCOMMIT")
    async with engine.connect() as connection:
        await connection.execute(text(f"CREATE DATABASE {name}"))
    await engine.dispose()


@pytest.fixture
def minimal() -> dict[str, Any]:
    made: dict[str, Any] = EXAMPLES["minimal"]().model_dump(mode="json")
    return made


@pytest.fixture
def paper() -> dict[str, Any]:
    made: dict[str, Any] = EXAMPLES["paper"]().model_dump(mode="json")
    return made
