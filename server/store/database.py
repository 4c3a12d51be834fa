"""The databases: the job engine's and the service's own tables, in two SQLite files or one PostgreSQL database."""

import logging
import os
import sqlite3
import time
from collections.abc import Callable
from typing import Any

import sqlalchemy as sa
from dbos import DBOS
from sqlalchemy import event
from sqlalchemy.exc import OperationalError, SQLAlchemyError
from sqlalchemy.exc import TimeoutError as PoolTimeoutError

from server.settings import ServiceSettings
from server.store.files import locked
from server.store.migration import migrate
from server.store.soundness import DatabaseError, expect_sound

_BUSY_S = 30
_CONNECT_S = 5
_START_S = 60.0
_POLL_S = 1.0
_CONNECTIONS = 20
_PASSING = ("the database system is", "terminating connection")
_CROWDED = "too many clients"
_FULL = ("disk is full", "No space left")
_LOG = logging.getLogger(__name__)


def prepare_database(settings: ServiceSettings, pause: Callable[[float], object] = time.sleep) -> sa.Engine:
    """Create or bring up to date all tables; a client of the engine never does, and processes start in any order.

    A database that does not answer is waited for, a minute at most: it may be starting too. `pause` sleeps in between,
    and ends the wait where it returns something true. Returns a pool of connections to the service's own tables.
    Raises DatabaseError naming the database.
    """
    engine = open_database(settings)
    deadline, waits = time.monotonic() + _START_S, False
    while True:
        try:
            with locked(settings.data / ".opening", os.O_RDWR | os.O_CREAT, wait=True):  # processes start at once
                expect_sound(settings)
                _create_tables(settings, engine)
            return engine
        except SQLAlchemyError as error:
            reason = reason_of(error)
            if _may_come(error) and time.monotonic() < deadline and not pause(_POLL_S):
                if not waits:
                    _LOG.warning("%s: waits for the database: %s", settings.database_name, reason)
                waits = True
                continue
            engine.dispose()
            raise DatabaseError(f"found {reason}", *_mend(reason), where=settings.database_name) from error


def _create_tables(settings: ServiceSettings, engine: sa.Engine) -> None:
    DBOS.migrate(settings.engine_url)
    with engine.begin() as connection:
        lock_writers(connection)
        migrate(connection, settings.database_name)


def _may_come(error: SQLAlchemyError) -> bool:
    """Return whether nothing answers, or a server that starts or stops; what a server refuses, it refuses again."""
    text = _text(error)
    return is_outage(error) and ("FATAL:" not in text or any(words in text for words in _PASSING))


def _mend(reason: str) -> tuple[str, str]:
    """Return what was expected of the database, and what to do."""
    if _CROWDED in reason:
        return "room for 20 connections, and 8 more for each worker", "raise max_connections of PostgreSQL"
    return "the service's database", "give another --data or mend SPIKE4DGS_DATABASE"


def reason_of(error: Exception) -> str:
    """Return in one line what went wrong, in the words of the database where it is the one that failed."""
    return _text(error).splitlines()[0]


def _text(error: Exception) -> str:
    return str(getattr(error, "orig", error))


def open_database(settings: ServiceSettings) -> sa.Engine:
    """Return connections to the service's own tables."""
    engine = _pool(settings, settings.catalogue_url)
    if settings.database is None:

        @event.listens_for(engine, "connect")
        def configure(connection: Any, record: Any) -> None:
            connection.execute("PRAGMA journal_mode=WAL")  # a reader does not wait for a writer
            connection.execute("PRAGMA synchronous=FULL")  # what was accepted outlives a power cut
            connection.create_function("lower", 1, _lower, deterministic=True)  # SQLite's own knows no umlauts

    return engine


def _lower(text: str | None) -> str | None:
    return None if text is None else text.lower()


def open_engine_database(settings: ServiceSettings) -> sa.Engine:
    """Return connections to the job engine's tables, for reading."""
    return _pool(settings, settings.engine_url.replace("postgresql://", "postgresql+psycopg://", 1))


def _pool(settings: ServiceSettings, url: str) -> sa.Engine:
    arguments = {"timeout": _BUSY_S} if settings.database is None else {"connect_timeout": _CONNECT_S}
    return sa.create_engine(
        url,
        connect_args=arguments,
        pool_pre_ping=settings.database is not None,
        pool_size=_CONNECTIONS,
        max_overflow=_CONNECTIONS,  # together as many as the web process has threads
    )


def lock_writers(connection: sa.Connection) -> None:
    """Let one transaction at a time write, from here to its end; call it before the transaction's first statement.

    Rows that are numbered in it become visible in the order of their numbers.
    """
    postgresql = connection.dialect.name == "postgresql"
    connection.exec_driver_sql("SELECT pg_advisory_xact_lock(4127400942)" if postgresql else "BEGIN IMMEDIATE")


def is_outage(error: SQLAlchemyError) -> bool:
    """Return whether the database did not answer, or is starting or busy: the same may be asked again later."""
    if isinstance(error, PoolTimeoutError):
        return True
    if not isinstance(error, OperationalError) or is_full(error):
        return False
    return "locked" in str(error.orig) if isinstance(error.orig, sqlite3.Error) else True


def is_full(error: SQLAlchemyError) -> bool:
    """Return whether the database has no room left on its disk."""
    return any(words in _text(error) for words in _FULL)
