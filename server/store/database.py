"""The databases: the job engine's and the service's own tables, in two SQLite files or one PostgreSQL database."""

from __future__ import annotations

from typing import Any

import sqlalchemy as sa
from dbos import DBOS
from sqlalchemy import event
from sqlalchemy.exc import SQLAlchemyError

from server.errors import ServiceError
from server.settings import ServiceSettings
from server.store.tables import metadata

_BUSY_S = 30


class DatabaseError(ServiceError):
    """A database that cannot be opened."""

    exit_code = 2


def prepare_database(settings: ServiceSettings) -> sa.Engine:
    """Create or bring up to date all tables; a client of the engine never does, and processes start in any order.

    Returns a pool of connections to the service's own tables. Raises DatabaseError naming the database.
    """
    settings.data.mkdir(parents=True, exist_ok=True)
    engine = open_database(settings)
    try:
        DBOS.migrate(settings.engine_url)
        with engine.begin() as connection:
            lock_writers(connection)  # two processes may start at once
            metadata.create_all(connection)
    except SQLAlchemyError as error:
        engine.dispose()
        reason = str(getattr(error, "orig", error)).splitlines()[0]
        raise DatabaseError(
            f"{settings.database_name}: found {reason}, expected the service's database; give another --data or "
            "mend SPIKE4DGS_DATABASE"
        ) from error
    return engine


def open_database(settings: ServiceSettings) -> sa.Engine:
    """Connections to the service's own tables."""
    if settings.database is not None:
        return sa.create_engine(settings.catalogue_url, pool_pre_ping=True, pool_size=10, max_overflow=20)
    engine = sa.create_engine(settings.catalogue_url, connect_args={"timeout": _BUSY_S})

    @event.listens_for(engine, "connect")
    def configure(connection: Any, record: Any) -> None:
        connection.execute("PRAGMA journal_mode=WAL")  # who reads does not wait for who writes
        connection.execute("PRAGMA synchronous=NORMAL")

    return engine


def lock_writers(connection: sa.Connection) -> None:
    """Let one transaction at a time write, from here to its end; call it before the transaction's first statement.

    What is numbered then becomes visible in the order of its numbers.
    """
    postgresql = connection.dialect.name == "postgresql"
    connection.exec_driver_sql("SELECT pg_advisory_xact_lock(4127400942)" if postgresql else "BEGIN IMMEDIATE")
