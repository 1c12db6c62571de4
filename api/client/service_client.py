"""A typed Python client of the service, for scripts, the command line and tests.

    with Client("http://127.0.0.1:8080") as service:
        plan = service.plan(EXAMPLES["paper"](), wait_s=5)
        operation = service.fly(plan.id)
        for event in service.events(last_id=0):
            print(event.kind, event.data)

Methods return the service's own models. An answer that is an error raises `ApiError` with the problem's detail.
"""

from __future__ import annotations

from collections.abc import Iterator

import httpx2

from skyfolio.api.client.event_lines import EventLines
from skyfolio.api.client.flight_requests import FlightRequests
from skyfolio.api.client.plan_requests import PlanRequests
from skyfolio.api.client.transport import raise_for
from skyfolio.api.store.event_log import Event


class Client(PlanRequests, FlightRequests):
    """The client of one service: everything that can be asked of it."""

    def events(self, last_id: int = 0, *, follow: bool = True) -> Iterator[Event]:
        """Yield events after `last_id`, then each new one as it comes; without `follow`, until the last one stored.

        While the service cannot store events they arrive late here, each with its number (`provisional` is left
        out).
        """
        headers = {**self.headers, "Last-Event-ID": str(last_id)}
        with self._http.stream(
            "GET", "/v1/events", headers=headers, params={"follow": follow}, timeout=httpx2.Timeout(70.0)
        ) as stream:
            if stream.status_code >= 400:
                stream.read()
                raise_for(stream, "GET", "/v1/events")
            lines = EventLines()
            for line in stream.iter_lines():
                yield from lines.take(line)
