"""Webhooks, sent to a real server; what is due is tried when a test says so."""

import base64
import hashlib
import hmac
import json
import threading
import time
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest
from fastapi.testclient import TestClient

from server.app import create_app
from server.client import RefusedError, ServiceClient
from server.schemas.captures import CaptureRequest
from server.schemas.webhooks import WebhookRequest
from server.services.services import Services
from server.services.targets import Target, allowed_address, target_of
from server.services.webhooks import BACKOFF_S, WebhookService
from server.settings import ServiceSettings
from server.store.tables import Entry
from server.store.webhooks import LEASE_S, Deliveries


class Receiver(ThreadingHTTPServer):
    """Keeps what it is sent; answers with `status`."""

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), Handler)
        self.status = 204
        self.got: list[tuple[dict[str, str], str]] = []

    @property
    def port(self) -> int:
        return self.server_address[1]


class Handler(BaseHTTPRequestHandler):
    server: Receiver

    def do_POST(self) -> None:
        body = self.rfile.read(int(self.headers["Content-Length"])).decode()
        self.server.got.append(({name.lower(): value for name, value in self.headers.items()}, body))
        self.send_response(self.server.status)
        self.send_header("Location", f"http://127.0.0.1:{self.server.port}/elsewhere")
        self.end_headers()

    def log_message(self, format: str, *args: object) -> None:
        pass


class Clock:
    def __init__(self) -> None:
        self.now = time.time() + 5  # events are stamped with the real one

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def receiver() -> Iterator[Receiver]:
    with Receiver() as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
        thread.start()
        yield server
        server.shutdown()
        thread.join()


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def services(tmp_path: Path, clock: Clock) -> Iterator[Services]:
    """Services whose threads do not run; lab.example is the receiver's host, and allowed."""
    services = Services(ServiceSettings(data=tmp_path))
    object.__setattr__(services.store, "clock", clock)
    object.__setattr__(services.store, "deliveries", Deliveries(services.store.database, clock))
    services.webhooks = WebhookService(services.store, ("lab.example",), lambda target: ["127.0.0.1"], clock)
    yield services
    services.engine.close()
    services.store.close()


@pytest.fixture
def client(tmp_path: Path) -> Iterator[ServiceClient]:
    settings = ServiceSettings(data=tmp_path, webhook_hosts=("localhost",))
    with TestClient(create_app(settings), base_url="http://127.0.0.1") as http:
        yield ServiceClient(http)


def ended(services: Services, number: int = 1) -> str:
    entry = Entry(f"j20260101-000000-{number:08x}", "job", "verify", "2026-01-01", {}, told="running", name="night")
    services.store.entries.add(entry)
    assert services.store.events.tell(entry.id, "running", "failed", {"error": "cam11 is dark"}) is not None
    return entry.id


def hook(services: Services, receiver: Receiver, *statuses: str) -> str:
    return services.store.webhooks.add(f"http://lab.example:{receiver.port}/told?by=us", list(statuses)).id


def test_an_event_arrives_once_signed_at_the_address_that_was_checked(services: Services, receiver: Receiver) -> None:
    webhook = hook(services, receiver, "failed", "done")
    hook(services, receiver, "done")
    job = ended(services)
    assert services.webhooks.look() == 1
    assert services.webhooks.look() == 0
    ((headers, body),) = receiver.got
    assert headers["host"] == f"lab.example:{receiver.port}"
    document = json.loads(body)
    assert (document["type"], document["data"]["id"], document["data"]["name"]) == ("job.failed", job, "night")
    assert document["data"]["error"] == "cam11 is dark"
    assert headers["webhook-id"] == f"msg_{webhook}_{document['data']['seq']}"
    key = base64.b64decode(services.store.webhooks.get(webhook).secret.removeprefix("whsec_"))
    signed = f"{headers['webhook-id']}.{headers['webhook-timestamp']}.{body}".encode()
    expected = base64.b64encode(hmac.new(key, signed, hashlib.sha256).digest()).decode()
    assert headers["webhook-signature"] == f"v1,{expected}"
    (delivery,) = services.webhooks.deliveries(webhook, 10).items
    assert (delivery.status, delivery.attempts, delivery.said) == ("delivered", 1, "HTTP 204")


@pytest.mark.parametrize("status", [500, 302])
def test_what_is_refused_is_tried_again_later_and_later(
    services: Services, receiver: Receiver, clock: Clock, status: int
) -> None:
    webhook = hook(services, receiver, "failed")
    ended(services)
    receiver.status = status
    assert services.webhooks.look() == 1
    for wait_s in BACKOFF_S:
        (delivery,) = services.webhooks.deliveries(webhook, 10).items
        assert (delivery.status, delivery.said, delivery.due_in_s) == ("waiting", f"HTTP {status}", wait_s)
        clock.now += wait_s - 0.5
        assert services.webhooks.look() == 0
        clock.now += 1
        assert services.webhooks.look() == 1
    (delivery,) = services.webhooks.deliveries(webhook, 10).items
    assert (delivery.status, delivery.attempts, delivery.due_in_s) == ("failed", len(BACKOFF_S) + 1, None)
    assert len(receiver.got) == len(BACKOFF_S) + 1
    assert len({headers["webhook-id"] for headers, _ in receiver.got}) == 1
    services.store.deliveries.prune()
    assert len(services.webhooks.deliveries(webhook, 10).items) == 1
    clock.now += 8 * 24 * 3600
    services.store.deliveries.prune()
    assert services.webhooks.deliveries(webhook, 10).items == []


def test_who_is_gone_is_left_alone(services: Services, receiver: Receiver) -> None:
    webhook = hook(services, receiver, "failed")
    ended(services)
    receiver.status = 410
    services.webhooks.look()
    assert services.webhooks.deliveries(webhook, 10).items[0].status == "failed"


def test_what_a_dead_process_was_sending_is_sent_by_another(
    services: Services, receiver: Receiver, clock: Clock
) -> None:
    webhook = hook(services, receiver, "failed")
    job = ended(services)
    assert len(services.store.deliveries.claim(10)) == 1  # and dies here
    assert services.webhooks.look() == 0
    services.store.entries.remove(job)  # what is owed outlives the entry
    clock.now += LEASE_S + 1
    assert services.webhooks.look() == 1
    assert json.loads(receiver.got[0][1])["data"]["id"] == job
    services.webhooks.remove(webhook)
    assert services.store.deliveries.of(webhook, 10) == []


def test_a_name_that_turns_private_is_not_spoken_to(services: Services, receiver: Receiver) -> None:
    found = iter([["93.184.216.34"], ["127.0.0.1"]])
    resolved: list[Target] = []

    def resolve(target: Target) -> list[str]:
        resolved.append(target)
        return next(found)

    services.webhooks = WebhookService(services.store, (), resolve)
    webhook = services.webhooks.add(WebhookRequest(url=f"http://turns.example:{receiver.port}/"))
    ended(services)
    services.webhooks.look()
    assert receiver.got == []
    said = services.webhooks.deliveries(webhook.id, 10).items[0].said
    assert said.startswith("found turns.example at the private address 127.0.0.1")
    assert len(resolved) == 2


@pytest.mark.parametrize(
    "address",
    [
        *(
            "127.0.0.1",
            "10.1.2.3",
            "192.168.0.1",
            "172.16.0.1",
            "169.254.169.254",
            "0.0.0.0",
            "100.64.0.1",
            "224.0.0.1",
        ),
        *(
            "224.0.0.1",
            "::1",
            "::",
            "fe80::1%eth0",
            "fd00::1",
            "fec0::1",
            "::ffff:10.0.0.1",
            "64:ff9b::a00:1",
            "2002:a00:1::",
            "ff02::1",
        ),
    ],
)
def test_private_addresses_are_refused(address: str) -> None:
    target = target_of("https://x.example/told")
    with pytest.raises(Exception, match=f"private address {address}"):
        allowed_address(target, ["93.184.216.34", address], ())
    assert allowed_address(target, [address], ("X.example",)) == address
    assert allowed_address(target, ["2606:4700::1111"], ()) == "2606:4700::1111"


@pytest.mark.parametrize(
    "url",
    ["ftp://x/", "http://", "http://u:p@localhost/", "http://localhost:99999/", "http://[::1/", "x"],
)
def test_only_plain_urls_are_taken(client: ServiceClient, url: str) -> None:
    with pytest.raises(RefusedError) as caught:
        client.add_webhook(url)
    assert caught.value.status == 422


def test_webhooks_over_rest(client: ServiceClient, receiver: Receiver) -> None:
    with pytest.raises(RefusedError, match="private address 127") as caught:
        client.add_webhook(f"http://127.0.0.1:{receiver.port}/")
    assert caught.value.status == 422
    made = client.add_webhook(f"http://localhost:{receiver.port}/", ["queued"])
    assert made.secret.startswith("whsec_")
    assert [one.id for one in client.webhooks()] == [made.id]
    assert "secret" not in client.webhooks()[0].model_dump()
    trial = client.try_webhook(made.id)
    assert (trial.ok, trial.said) == (True, "HTTP 204")
    assert json.loads(receiver.got[0][1])["type"] == "test"
    client.delete_webhook(made.id)
    assert client.webhooks() == []
    with pytest.raises(RefusedError, match="no webhook"):
        client.deliveries(made.id)


def test_the_service_delivers_by_itself(client: ServiceClient, receiver: Receiver) -> None:
    made = client.add_webhook(f"http://localhost:{receiver.port}/", ["queued"])
    capture = client.start_capture("lab3x3", CaptureRequest(ticks=5))
    for _ in range(400):
        if receiver.got:
            break
        time.sleep(0.025)
    document = json.loads(receiver.got[0][1])
    assert (document["type"], document["data"]["id"]) == ("capture.queued", capture.id)
    assert client.deliveries(made.id)[0].event == document["data"]["seq"]
