"""Commands of an operation with one ETag: of those that come at once, one is carried out."""

from collections import Counter
from concurrent.futures import ThreadPoolExecutor

from skyfolio.api.flights.operation_views import State
from skyfolio.planner import EXAMPLES
from tests.api.flying import Flight, flight, service

SPEEDUP = 10.0
PATIENT = {"heartbeat_stale_s": 6.0, "heartbeat_lost_s": 10.0}
SHORT = EXAMPLES["minimal"]().with_changes(slots=30, altitude_m=8.0)
AT_ONCE = 50


def at_once(flown: Sky, operation_id: str, verb: str, etag: str | None) -> Counter[int]:
    """Statuses of many clients that command the same thing."""
    headers = {} if etag is None else {"If-Match": etag}

    def command(_: int) -> int:
        return flown.http.post(f"/v1/operations/{operation_id}:{verb}", headers=headers).status_code

    with ThreadPoolExecutor(AT_ONCE) as pool:
        return Counter(pool.map(command, range(AT_ONCE)))


def test_of_fifty_commands_with_one_etag_one_is_carried_out() -> None:
    with (
        service(SPEEDUP, rate_burst=10_000, **PATIENT) as (http, endpoint),
        flight(http, endpoint, SHORT, SPEEDUP) as flown,
    ):
        operation_id = flown.client.fly(flown.plan.id, launch="manual").id
        path = f"/v1/operations/{operation_id}"
        flown.until(operation_id, lambda view: view.state == State.READY)
        statuses = at_once(flown, operation_id, "start", http.get(path).headers["ETag"])
        assert statuses == {200: 1, 412: AT_ONCE - 1}
        flown.until(operation_id, lambda view: view.state == State.FLYING)
        for verb in ("pause", "resume"):
            statuses = at_once(flown, operation_id, verb, http.get(path).headers["ETag"])
            assert statuses == {200: 1, 412: AT_ONCE - 1}, verb
        assert at_once(flown, operation_id, "pause", None) == {200: 1, 409: AT_ONCE - 1}
