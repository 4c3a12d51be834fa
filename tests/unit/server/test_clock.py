"""Tests whose clock counts: the database's, read now and then, and counted on where it cannot be read."""

import contextlib
from types import SimpleNamespace

import pytest
from sqlalchemy.exc import OperationalError

from server.store import clock
from server.store.clock import DatabaseClock


class Server:
    """A PostgreSQL that only knows the time: 1000 s when this machine's monotonic clock is at 0."""

    dialect = SimpleNamespace(name="postgresql")

    def __init__(self) -> None:
        self.asked, self.answers, self.monotonic = 0, True, 0.0

    @contextlib.contextmanager
    def connect(self):
        if not self.answers:
            raise OperationalError("SELECT", {}, Exception("gone"))
        yield self

    def exec_driver_sql(self, query: str):
        self.asked += 1
        return self

    def scalar_one(self) -> float:
        return 1000.0 + self.monotonic


@pytest.fixture
def server(monkeypatch):
    server = Server()
    monkeypatch.setattr(clock.time, "monotonic", lambda: server.monotonic)
    return server


def test_it_is_read_once_a_minute_and_counted_on(server) -> None:
    now = DatabaseClock(server, own=lambda: 1000.0)
    for server.monotonic in (0.0, 1.5, 59.0):
        assert now() == 1000.0 + server.monotonic
    assert server.asked == 1
    server.monotonic = 61.0
    assert now() == 1061.0
    assert server.asked == 2


def test_the_last_reading_goes_on_where_the_database_is_gone(server) -> None:
    now = DatabaseClock(server, own=lambda: 1000.0)
    now()
    server.answers, server.monotonic = False, 200.0
    assert now() == 1200.0


def test_one_that_was_never_read_says_so(server) -> None:
    now = DatabaseClock(server)
    server.answers = False
    with pytest.raises(OperationalError):
        now()
    server.answers = True
    assert now() == 1000.0


@pytest.mark.parametrize(("own", "said"), [(940.0, "60 s behind"), (1060.0, "60 s ahead of"), (1004.0, "")])
def test_a_clock_that_is_off_is_told_once(server, caplog, own, said) -> None:
    now = DatabaseClock(server, own=lambda: own + server.monotonic)
    for server.monotonic in (0.0, 100.0, 200.0):
        assert now() == 1000.0 + server.monotonic
    assert [said in record.message for record in caplog.records] == ([True] if said else [])
