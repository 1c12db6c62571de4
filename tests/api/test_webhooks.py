"""Webhooks: signed, in order, at least once, whatever is killed; and nothing that is secret is told."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from fastapi.testclient import TestClient

from skyfolio.api.common.idempotency import fresh
from skyfolio.api.common.settings import Settings
from skyfolio.api.http.app import create_app
from skyfolio.api.store import Database
from skyfolio.api.store.event_log import EventLog
from skyfolio.api.webhooks.delivery import GIVE_UP_S, Answer, Deliveries, post
from skyfolio.api.webhooks.hooks import Hooks
from skyfolio.api.webhooks.signing import signature
from skyfolio.api.webhooks.topics import Topic, topic_of
from skyfolio.planner import EXAMPLES
from tests.api.sky import flight, sky

SECRET = "correct horse battery"  # noqa: S105
URL = "https://receiver.example/hook?token=hunter2"
LOST = {"uav_id": "uav-1", "cause": "heartbeat_lost"}


class Receiver:
    """Takes deliveries as `answers` say, and everything after the last of them."""

    def __init__(self, *answers: int | None) -> None:
        self.answers = list(answers)
        self.got: list[tuple[dict[str, Any], dict[str, str]]] = []

    async def __call__(self, url: str, body: bytes, headers: Mapping[str, str]) -> Answer:
        assert url == URL
        assert headers["Skyfolio-Signature"] == signature(SECRET, headers["Skyfolio-Timestamp"], body)
        self.got.append((json.loads(body), dict(headers)))
        status = self.answers.pop(0) if self.answers else 204
        return Answer(status, None if status else "ConnectError")

    @property
    def deliveries(self) -> list[str]:
        return [headers["Skyfolio-Delivery"] for _, headers in self.got]


class Desk:
    """A database with its hooks and events, and the deliveries of one process."""

    def __init__(self, database: Database, events: EventLog, receiver: Receiver) -> None:
        self.database, self.events, self.hooks = database, events, Hooks(database)
        self.deliveries = Deliveries(self.hooks, events, database, receiver)
        self.task = asyncio.create_task(self.deliveries.run())

    @classmethod
    async def open(cls, url: str, receiver: Receiver) -> Desk:
        database = await Database.open(url)
        return cls(database, await EventLog.open(database), receiver)

    async def close(self) -> None:
        self.task.cancel()
        await asyncio.gather(self.task, return_exceptions=True)
        await self.database.close()

    async def register(self, *topics: Topic) -> str:
        hook = await self.hooks.register(
            fresh("hook"), url=URL, topics=topics or (Topic.LOSS,), secret=SECRET, after=self.events.last_id
        )
        self.deliveries.wake()
        return hook.id


@pytest.fixture
def url(tmp_path: Path) -> str:
    return f"sqlite+aiosqlite:///{tmp_path}/service.db"


async def until(is_so: Any) -> None:
    async with asyncio.timeout(30):
        while not is_so():  # noqa: ASYNC110
            await asyncio.sleep(0.01)


def test_the_signature_is_hmac_sha256_of_time_and_body() -> None:
    # echo -n '1700000000.{"a":1}' | openssl dgst -sha256 -hmac 'correct horse battery'
    made = signature(SECRET, "1700000000", b'{"a":1}')
    assert made == "v1=98a51b330afc58453095af8ed727e6cc4bd565edb4230482620146eda751b416"


@pytest.mark.parametrize(
    ("kind", "data", "topic"),
    [
        ("uav_lost", LOST, Topic.LOSS),
        ("incident", {"step": "proposed"}, Topic.APPROVAL),
        ("incident", {"step": "approved"}, Topic.APPROVAL),
        ("incident", {"step": "uploading"}, None),
        ("operation", {"state": "completed_partly"}, Topic.COMPLETION),
        ("operation", {"state": "flying"}, None),
        ("slip", {}, None),
    ],
)
def test_losses_approvals_and_completions_are_told(kind: str, data: dict[str, Any], topic: Topic | None) -> None:
    assert topic_of(kind, data) is topic


async def test_a_hook_is_told_in_order_what_it_asked_for_and_what_comes_after_it_was_made(url: str) -> None:
    receiver = Receiver()
    desk = await Desk.open(url, receiver)
    desk.events.add("uav_lost", uav_id="before")
    await until(lambda: desk.events.last_id == 1)
    hook = await desk.register(Topic.LOSS, Topic.COMPLETION)
    for number in range(3):
        desk.events.add("uav_lost", uav_id=f"uav-{number}")
        desk.events.add("slip", uav_id="uav-1")
        desk.events.add("incident", step="proposed")
    desk.events.add("operation", state="completed")
    await until(lambda: len(receiver.got) == 4)
    told = [(body["topic"], body["data"].get("uav_id")) for body, _ in receiver.got]
    assert told == [("loss", "uav-0"), ("loss", "uav-1"), ("loss", "uav-2"), ("completion", None)]
    assert receiver.deliveries == [f"{hook}.{number}" for number in (2, 5, 8, 11)]
    assert [body["id"] for body, _ in receiver.got] == [2, 5, 8, 11]
    await desk.close()


def test_what_is_not_taken_is_sent_again_later_and_later_and_the_rest_waits() -> None:
    receiver, at = Receiver(500, None, 302, 204), []
    with sky(EXAMPLES["minimal"]()) as made:

        async def noting(url: str, body: bytes, headers: Mapping[str, str]) -> Answer:
            at.append(made.now_s)
            return await receiver(url, body, headers)

        async def lose() -> None:
            made.service.events.add("uav_lost", **LOST)
            made.service.events.add("uav_lost", uav_id="uav-2")

        made.service.deliveries._send = noting
        made.client.register_webhook(URL, ["loss"], SECRET)
        made.run(lose())
        made.wait(lambda: len(receiver.got) == 5)
        made.let_pass(1.0)
        (hook,) = made.client.webhooks()
    assert (hook.attempts, hook.last_status, hook.abandoned) == (0, 204, 0)
    assert len(set(receiver.deliveries[:4])) == 1
    assert receiver.deliveries[4] != receiver.deliveries[3]
    waited = [later - sooner for sooner, later in pairwise(at)]
    assert waited[:3] == pytest.approx([1.0, 2.0, 4.0], abs=0.5)


async def test_a_delivery_that_nobody_takes_for_a_day_is_given_up_and_counted(
    url: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    receiver = Receiver(500, 500)
    desk = await Desk.open(url, receiver)
    hook = await desk.register()
    desk.events.add("uav_lost", **LOST)
    await until(lambda: len(receiver.got) == 1)
    monkeypatch.setattr("skyfolio.api.webhooks.delivery.GIVE_UP_S", 0.5)
    await until(lambda: len(receiver.got) == 2)
    desk.events.add("uav_lost", uav_id="uav-2")
    await until(lambda: len(receiver.got) == 3)
    await until(lambda: not desk.deliveries._sending)
    assert (await desk.hooks.get(hook)).view.abandoned == 1
    assert GIVE_UP_S == 86_400.0
    await desk.close()


async def test_what_a_killed_service_had_not_finished_is_sent_by_the_next_one(url: str) -> None:
    never = asyncio.Event()

    class Hangs(Receiver):
        async def __call__(self, url: str, body: bytes, headers: Mapping[str, str]) -> Answer:
            await super().__call__(url, body, headers)
            await never.wait()
            raise AssertionError

    first, second = Hangs(), Receiver()
    desk = await Desk.open(url, first)
    hook = await desk.register()
    desk.events.add("uav_lost", **LOST)
    desk.events.add("uav_lost", uav_id="uav-2")
    await until(lambda: len(first.got) == 1)
    await desk.close()  # the receiver has it, and the service does not know: nothing was stored since
    again = await Desk.open(url, second)
    await until(lambda: len(second.got) == 2)
    assert second.deliveries == [f"{hook}.1", f"{hook}.2"]
    assert first.deliveries[0] == second.deliveries[0]
    await again.close()


def test_a_flight_tells_of_its_loss_and_its_end() -> None:
    receiver = Receiver()
    with flight(EXAMPLES["minimal"]().with_changes(slots=12, altitude_m=8.0)) as flown:
        flown.service.deliveries._send = receiver
        flown.client.register_webhook(URL, ["loss", "completion", "approval"], SECRET)
        operation = flown.take_off(replanning="approve")
        flown.inject(kill(2))
        view = flown.until(operation, lambda view: view.proposal is not None)
        assert view.proposal is not None
        flown.client.decide(operation, view.proposal.incident, agreed=True)
        flown.ended(operation)
        flown.let_pass(2.0)
    assert receiver.got[0][0]["topic"] == "loss"
    assert receiver.got[-1][0]["topic"] == "completion"
    steps = [body["data"]["step"] for body, _ in receiver.got if body["topic"] == "approval"]
    assert steps == ["proposed", "approved"]


def kill(system_id: int) -> Any:
    from skyfolio.api.fleet.simulated_fleet import fault_of  # noqa: PLC0415

    return fault_of("kill", system_id, {}, stations=False)


# -- REST -------------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def http() -> Any:
    with TestClient(create_app(Settings(warm_up=False)), raise_server_exceptions=False) as made:
        yield made


REQUEST = {"url": URL, "topics": ["loss"], "secret": SECRET}


def test_a_hook_is_registered_once_a_key_listed_tested_and_deleted(
    http: TestClient, capfd: pytest.CaptureFixture[str]
) -> None:
    receiver = Receiver(204, 500)
    http.app.state.service.deliveries._send = receiver  # type: ignore[attr-defined]
    made = http.post("/v1/webhooks", json=REQUEST, headers={"Idempotency-Key": "one"})
    assert made.status_code == 201
    hook = made.json()["id"]
    assert http.post("/v1/webhooks", json=REQUEST, headers={"Idempotency-Key": "one"}).json()["id"] == hook
    other = http.post("/v1/webhooks", json={**REQUEST, "topics": ["approval"]}, headers={"Idempotency-Key": "one"})
    assert other.status_code == 422
    assert [row["id"] for row in http.get("/v1/webhooks").json()] == [hook]
    assert http.post(f"/v1/webhooks/{hook}:test").json() == {"delivered": True, "status": 204, "error": None}
    assert http.post(f"/v1/webhooks/{hook}:test").json() == {"delivered": False, "status": 500, "error": None}
    assert receiver.got[0][0]["topic"] == "test"
    said = made.text + http.get("/v1/webhooks").text + http.get(f"/v1/webhooks/{hook}").text
    assert SECRET not in said
    assert http.delete(f"/v1/webhooks/{hook}").status_code == 204
    assert http.get(f"/v1/webhooks/{hook}").status_code == 404
    assert http.post(f"/v1/webhooks/{hook}:test").status_code == 404
    logged = "".join(capfd.readouterr())
    assert SECRET not in logged
    assert "hunter2" not in logged


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"url": "ftp://x/y"}, "url"),
        ({"url": "https://me:pw@host/x"}, "url"),
        ({"url": "http://169.254.169.254/latest"}, "url"),
        ({"url": "http://[fe80::1]/x"}, "url"),
        ({"url": "http://host:99999/x"}, "url"),
        ({"topics": []}, "topics"),
        ({"topics": ["weather"]}, "topics.0"),
        ({"secret": "only a little"}, "secret"),
    ],
)
def test_what_is_no_receiver_is_refused_by_field_and_no_secret_is_said_again(
    http: TestClient, change: dict[str, Any], field: str
) -> None:
    refused = http.post("/v1/webhooks", json={**REQUEST, **change})
    assert refused.status_code == 422
    assert [row["field"] for row in refused.json()["errors"]] == [field]
    assert change.get("secret", SECRET) not in refused.text
    assert http.get("/v1/webhooks").json() == []


async def test_a_receiver_that_is_not_there_is_an_answer_and_no_exception() -> None:
    answer = await post("http://127.0.0.1:9/hook", b"{}", {})
    assert answer.status is None
    assert answer.error == "ConnectError"
