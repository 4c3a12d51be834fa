"""What is read most often of the job engine's tables, without the thirty columns that its own client brings along."""

from __future__ import annotations

from collections.abc import Sequence

import sqlalchemy as sa

from server.settings import ServiceSettings
from server.store.database import open_engine_database

_AT_A_TIME = 5000  # parameters of one statement


class EngineTables:
    """A reader of the job engine's workflow table, which the engine documents; it never writes."""

    def __init__(self, settings: ServiceSettings) -> None:
        schema = None if settings.database is None else "dbos"
        self._workflows = sa.table("workflow_status", sa.column("workflow_uuid"), sa.column("status"), schema=schema)
        self._engine = open_engine_database(settings)

    def statuses(self, ids: Sequence[str]) -> dict[str, str]:
        """The engine's own word for the state of each of `ids` that it knows."""
        columns = self._workflows.c
        found: dict[str, str] = {}
        if not ids:
            return found
        with self._engine.connect() as connection:
            for first in range(0, len(ids), _AT_A_TIME):
                part = ids[first : first + _AT_A_TIME]
                query = sa.select(columns.workflow_uuid, columns.status).where(columns.workflow_uuid.in_(part))
                found |= {row[0]: row[1] for row in connection.execute(query)}
        return found

    def close(self) -> None:
        """Let go of the database."""
        self._engine.dispose()
