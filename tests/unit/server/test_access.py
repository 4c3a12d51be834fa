"""Tokens, roles and rates, and what the command line refuses."""

import hashlib
import hmac
import sqlite3
import threading
from pathlib import Path

import pytest
from click.testing import CliRunner
from fastapi.testclient import TestClient

from server.app import create_app
from server.cli.main import cli
from server.errors import ExposedError, TokenError
from server.middleware.gate import _MOST_CLIENTS, OPEN, READY, Rates, address_of, is_guarded
from server.services.access import AccessService
from server.settings import ServiceSettings, SettingsError, settings_of
from server.store.store import Store

LOOPBACK = "http://127.0.0.1"


def bearer(secret: str) -> dict[str, str]:
    return {"Authorization": f"Bearer {secret}"}


@pytest.fixture
def http(tmp_path: Path):
    with TestClient(create_app(ServiceSettings(data=tmp_path)), base_url=LOOPBACK) as client:
        yield client


@pytest.fixture
def secrets(http) -> dict[str, str]:
    """A viewer's and an operator's token, known to the service at once."""
    services = http.app.state.services
    made = {role: services.store.tokens.add(f"the-{role}", role) for role in ("viewer", "operator")}
    services.access._read_at = None
    return made


def test_only_a_digest_is_kept(tmp_path: Path) -> None:
    store = Store(ServiceSettings(data=tmp_path))
    secret = store.tokens.add("desk", "operator")
    (kept,) = store.tokens.all()
    store.close()
    assert kept.digest == hashlib.sha256(secret.encode()).hexdigest()
    assert len(secret) >= 4 + 43  # 256 bits in base 64
    written = b"".join(path.read_bytes() for path in tmp_path.glob("catalogue.sqlite*"))
    assert kept.digest.encode() in written
    assert secret.encode() not in written


def test_info_says_what_a_token_allows(http, secrets) -> None:
    assert [http.get("/v1/info", headers=bearer(secret)).json()["role"] for secret in secrets.values()] == list(secrets)


def test_info_has_no_role_where_no_token_is_needed(http) -> None:
    assert http.get("/v1/info").json()["role"] is None


def test_names_of_tokens_are_unique(tmp_path: Path) -> None:
    store = Store(ServiceSettings(data=tmp_path))
    assert store.tokens.add("desk", "viewer") != store.tokens.add("wall", "viewer")
    with pytest.raises(TokenError, match="found a token desk already"):
        store.tokens.add("desk", "operator")
    store.tokens.remove("desk")
    with pytest.raises(TokenError, match="found no token desk"):
        store.tokens.remove("desk")
    assert [token.name for token in store.tokens.all()] == ["wall"]
    store.close()


def test_every_route_of_the_interface_needs_a_token(http, secrets) -> None:
    paths = http.get("/openapi.json").json()["paths"]
    asked = [(method, path) for path, item in paths.items() for method in item if path not in (*OPEN, READY)]
    assert len(asked) > 20
    for method, path in asked:
        answer = http.request(method, path)
        assert (answer.status_code, method, path) == (401, method, path)
        assert answer.headers["www-authenticate"].startswith("Bearer")
        assert method == "head" or answer.json()["type"] == "urn:spike4dgs:unauthorized"
    assert http.get("/v1/healthz").status_code == 200
    assert http.get("/").status_code == 200
    assert is_guarded("/metrics")


def test_without_a_token_readiness_is_told_by_its_status_alone(http, secrets) -> None:
    bare = http.get("/v1/readyz")
    assert (bare.status_code, bare.json()["detail"], "checks" in bare.json()) == (503, "not ready", False)
    assert http.get("/v1/readyz", headers=bearer("s4d_guess")).status_code == 401
    http.app.state.services.store.workers.enter("a", ["tasks"])
    assert (http.get("/v1/readyz").status_code, http.get("/v1/readyz").json()) == (200, {})
    whole = http.get("/v1/readyz", headers=bearer(secrets["viewer"]))
    assert (whole.status_code, whole.json()["worker"]["ok"]) == (200, True)


@pytest.mark.parametrize("given", ["", "Bearer", "Bearer ", "Bearer x", "Basic {}", "{}", "Bearer {}x", "Bearer\t{}"])
def test_another_token_is_none(http, secrets, given: str) -> None:
    headers = {"Authorization": given.format(secrets["operator"])}
    assert http.get("/v1/info", headers=headers).status_code == 401
    assert http.get("/v1/info", params={"token": secrets["operator"]}).status_code == 401


def test_a_viewer_reads_and_an_operator_does_all(http, secrets) -> None:
    for role in secrets:
        answer = http.get("/v1/jobs", headers=bearer(secrets[role]))
        assert answer.status_code == 200
        assert answer.headers["cache-control"] == "no-store"
        assert http.get("/v1/readyz", headers=bearer(secrets[role])).status_code == 503  # no worker
    for method, path in (("POST", "/v1/jobs"), ("DELETE", "/v1/jobs/x"), ("PUT", "/v1/jobs/x/priority")):
        answer = http.request(method, path, headers=bearer(secrets["viewer"]), json={})
        assert answer.status_code == 403
        assert "the-viewer, expected an operator" in answer.json()["detail"]
        override = bearer(secrets["viewer"]) | {"X-HTTP-Method-Override": "GET"}
        assert http.request(method, path, headers=override, json={}).status_code == 403
        assert http.request(method, path, headers=bearer(secrets["operator"]), json={}).status_code in (404, 422)
    override = bearer(secrets["viewer"]) | {"X-HTTP-Method-Override": "DELETE", "X-HTTP-Method": "DELETE"}
    assert http.get("/v1/jobs", headers=override).status_code == 200


def test_comparison_takes_the_same_time_for_all(http, secrets, monkeypatch) -> None:
    compared = []
    same = hmac.compare_digest
    monkeypatch.setattr(
        "server.services.access.hmac.compare_digest", lambda a, b: compared.append((a, b)) or same(a, b)
    )
    for secret in (secrets["operator"], secrets["viewer"], "s4d_other"):
        compared.clear()
        http.get("/v1/info", headers=bearer(secret))
        assert len(compared) == 2  # every token, whichever fits


def test_changes_are_seen_when_the_cache_is_old(tmp_path: Path) -> None:
    settings = ServiceSettings(data=tmp_path)
    store, now = Store(settings), [0.0]
    access = AccessService(store.tokens, settings, clock=lambda: now[0])
    access.refresh()
    assert access.admit("POST", None) is None
    secret = store.tokens.add("desk", "operator")
    assert not access.stale
    now[0] = 2.0
    assert access.stale
    access.refresh()
    token = access.admit("POST", f"bearer {secret}")
    assert token is not None
    assert token.name == "desk"
    store.close()


@pytest.mark.parametrize("change", [{"host": "0.0.0.0"}, {"host": "::"}, {"hosts": ("lab.example",)}])
def test_without_a_token_nobody_else_is_served(tmp_path: Path, change: dict) -> None:
    """Also where the last token is removed while the service runs."""
    with TestClient(create_app(ServiceSettings(data=tmp_path, **change)), base_url=LOOPBACK) as http:
        assert http.get("/v1/jobs").status_code == 401
        with pytest.raises(ExposedError):
            http.app.state.services.access.check_exposure()


def test_a_database_that_refuses_lets_nobody_in(http, secrets) -> None:
    database = http.app.state.services.settings.data / "catalogue.sqlite"
    with sqlite3.connect(database) as connection:
        connection.execute("DROP TABLE tokens")
    http.app.state.services.access._read_at = None
    answer = http.get("/v1/info", headers=bearer(secrets["operator"]))
    assert (answer.status_code, answer.json()["type"]) == (503, "urn:spike4dgs:database")


@pytest.mark.parametrize("flags", [["--host", "0.0.0.0"], ["--host", "::"], ["--allow-host", "lab.example"]])
def test_serve_refuses_others_without_a_token(tmp_path: Path, flags: list[str], monkeypatch) -> None:
    heard = threading.Event()
    monkeypatch.setattr("server.cli.serve.listening", lambda *_: heard.set())
    error = CliRunner().invoke(cli, ["serve", *flags, "--port", "0", "--data", str(tmp_path)]).exception
    assert isinstance(error, ExposedError)
    assert error.exit_code == 2
    assert str(error).startswith("found no token, expected one before the service is reached from elsewhere")
    assert "\n" not in str(error)
    assert not heard.is_set()


def test_tokens_of_the_command_line(tmp_path: Path) -> None:
    def run(*arguments: str):
        return CliRunner().invoke(cli, ["token", *arguments, "--data", str(tmp_path)])

    assert "no tokens" in run("list").output
    added = run("add", "desk", "--role", "operator")
    assert added.output.startswith("s4d_")
    listed = run("list").output
    assert listed.split()[:2] == ["desk", "operator"]
    assert added.output.strip() not in listed
    assert isinstance(run("add", "desk", "--role", "viewer").exception, TokenError)
    assert run("add", "../x", "--role", "viewer").exit_code == 2
    assert run("add", "wall").exit_code == 2
    assert "the last" in run("remove", "desk").output


@pytest.mark.parametrize(
    ("change", "found"),
    [
        ({"hosts": ("lab.example/x",)}, "lab.example/x"),
        ({"hosts": ("*",)}, "*"),
        ({"origins": ("lab.example",)}, "lab.example"),
        ({"origins": ("null",)}, "null"),
        ({"origins": ("https://lab.example/",)}, "https://lab.example/"),
    ],
)
def test_names_that_would_let_anybody_in_are_refused(change: dict, found: str) -> None:
    with pytest.raises(SettingsError) as caught:
        settings_of(rig=None, devices=None, **change)
    assert f"found {found}, expected" in str(caught.value)


def test_hosts_and_origins_come_from_the_environment(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setenv("SPIKE4DGS_HOSTS", "lab.example, Lab2:8443")
    monkeypatch.setenv("SPIKE4DGS_ORIGINS", "https://lab.example")
    settings = ServiceSettings(data=tmp_path)
    assert (settings.hosts, settings.origins) == (("lab.example", "lab2:8443"), ("https://lab.example",))
    assert settings.exposed


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"Host": "lab.example"}, 401),
        ({"Host": "LAB.example:8000"}, 401),
        ({"Host": "lab2:8443"}, 401),
        ({"Host": "lab.example", "Origin": "https://lab.example"}, 401),
        ({"Host": "lab.example", "Origin": "http://lab.example"}, 401),
        ({"Host": "lab2:8443", "Origin": "https://lab2:8443"}, 403),
        ({"Host": "lab2"}, 403),
        ({"Host": "sub.lab.example"}, 403),
        ({"Host": "lab.example@evil.example"}, 403),
        ({"Host": "evil.example/lab.example"}, 403),
        ({"Host": "lab.example", "Origin": "https://evil.example"}, 403),
    ],
)
def test_who_is_let_in_beside_loopback(tmp_path: Path, headers: dict, status: int) -> None:
    settings = ServiceSettings(data=tmp_path, hosts=("lab.example", "lab2:8443"), origins=("https://lab.example",))
    with TestClient(create_app(settings), base_url=LOOPBACK) as http:
        assert http.get("/v1/info", headers=headers).status_code == status


def test_a_bucket_empties_and_fills() -> None:
    now = [0.0]
    rates = Rates(rate=10, burst=3, clock=lambda: now[0])
    assert [rates.wait_s("a") for _ in range(4)] == [0, 0, 0, pytest.approx(0.1)]
    assert rates.wait_s("b") == 0
    now[0] = 0.1
    assert rates.wait_s("a") == 0
    now[0] = 100.0
    assert [rates.wait_s("a") for _ in range(4)] == [0, 0, 0, pytest.approx(0.1)]
    for n in range(_MOST_CLIENTS + 5):
        rates.wait_s(f"client {n}")
    assert len(rates._buckets) == _MOST_CLIENTS


def test_an_ipv6_network_is_one_client() -> None:
    def of(host: str) -> str:
        return address_of({"type": "http", "client": (host, 1)})

    assert of("2001:db8::1") == of("2001:db8::ffff:2") != of("2001:db8:1::1")
    assert of("10.0.0.1") != of("10.0.0.2")
    assert of("testclient") == "testclient"


def test_too_many_requests_are_told_when_to_come_again(tmp_path: Path) -> None:
    settings = ServiceSettings(data=tmp_path, write_rate=0.01, write_burst=2, read_rate=0.01, read_burst=3)
    with TestClient(create_app(settings), base_url=LOOPBACK) as http:
        assert [http.post("/v1/jobs", json={}).status_code for _ in range(3)] == [422, 422, 429]
        answers = [http.get("/v1/info") for _ in range(4)]
        assert [answer.status_code for answer in answers] == [200, 200, 200, 429]
        assert int(answers[-1].headers["retry-after"]) > 1
        assert answers[-1].headers["content-type"] == "application/problem+json"
        secret = http.app.state.services.store.tokens.add("desk", "operator")
        http.app.state.services.access._read_at = None
        assert http.get("/v1/info", headers=bearer(secret)).status_code == 200  # a token is a client of its own
        assert http.get("/v1/info", headers=bearer("s4d_guess")).status_code == 429  # who guesses is counted
