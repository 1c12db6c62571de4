"""The typed client of the service, for the command line, the dashboard's tests and scripts.

    service_client, async_client       the client, and the same for asyncio; event_lines: what the stream of events says
    plan_requests, flight_requests     one method per request; each returns the model that the service itself sends
    transport                          the connection, the key, pages, and errors

It may import the models of `common`, `plans`, `fleet`, `flights` and `store`, but opens no database and starts nothing:
everything goes over HTTP. A new route gets a method here together with its test. Methods raise `ApiError` with the
problem document of the service; connection errors are those of httpx2.
"""

from skyfolio.api.client.async_client import AsyncClient
from skyfolio.api.client.service_client import Client
from skyfolio.api.client.transport import ApiError

__all__ = ["ApiError", "AsyncClient", "Client"]
