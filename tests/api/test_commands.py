"""Commands of an operation with one ETag: of those that come at once, one is carried out."""

from collections import Counter

from skyfolio.api.flights.operation_views import State
from skyfolio.planner import EXAMPLES
from tests.api.sky import Ask, Sky, flight

SHORT = EXAMPLES["minimal"]().with_changes(slots=30, altitude_m=8.0)
AT_ONCE = 50


def at_once(flown: Sky, operation_id: str, verb: str, etag: str | None) -> Counter[int]:
    """Statuses of many clients that command the same thing."""
    headers = {} if etag is None else {"If-Match": etag}

    asked = [Ask("POST", f"/v1/operations/{operation_id}:{verb}", headers=headers)] * AT_ONCE
    return Counter(answer.status_code for answer in flown.at_once(asked))


def test_of_fifty_commands_with_one_etag_one_is_carried_out() -> None:
    with flight(SHORT) as flown:
        operation_id = flown.client.fly(flown.plan.id, launch="manual").id
        path = f"/v1/operations/{operation_id}"
        flown.until(operation_id, lambda view: view.state == State.READY)
        statuses = at_once(flown, operation_id, "start", flown.http.get(path).headers["ETag"])
        assert statuses == {200: 1, 412: AT_ONCE - 1}
        flown.until(operation_id, lambda view: view.state == State.FLYING)
        for verb in ("pause", "resume"):
            statuses = at_once(flown, operation_id, verb, flown.http.get(path).headers["ETag"])
            assert statuses == {200: 1, 412: AT_ONCE - 1}, verb
        assert at_once(flown, operation_id, "pause", None) == {200: 1, 409: AT_ONCE - 1}
