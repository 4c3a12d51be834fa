"""Everything that is remembered, opened once by each process."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import sqlalchemy as sa

from server.settings import ServiceSettings
from server.store.artefacts import Artefacts
from server.store.calibrations import Calibrations
from server.store.database import prepare_database
from server.store.deliveries import Deliveries
from server.store.entries import Entries
from server.store.events import Events
from server.store.files import DataFolder
from server.store.idempotency import Idempotency
from server.store.rig_files import RigFiles
from server.store.tokens import Tokens
from server.store.uploads import Uploads
from server.store.webhooks import Webhooks
from server.store.workers import Workers


@dataclass(frozen=True)
class Store:
    """The tables and folders of one service."""

    database: sa.Engine
    folder: DataFolder
    entries: Entries
    events: Events
    artefacts: Artefacts
    idempotency: Idempotency
    workers: Workers
    calibrations: Calibrations
    rig_files: RigFiles
    uploads: Uploads
    tokens: Tokens
    webhooks: Webhooks
    deliveries: Deliveries

    @classmethod
    def open(cls, settings: ServiceSettings, pause: Callable[[float], object] = time.sleep) -> Store:
        """Open, create or bring up to date; `pause` as in `prepare_database`. Raises DatabaseError."""
        database = prepare_database(settings, pause)
        folder, calibrations = DataFolder(settings.data), Calibrations(database)
        return cls(
            database,
            folder,
            Entries(database),
            Events(database),
            Artefacts(database),
            Idempotency(database),
            Workers(database, dead_s=settings.dead_s),
            calibrations,
            RigFiles(folder, calibrations),
            Uploads(database),
            Tokens(database),
            Webhooks(database),
            Deliveries(database),
        )

    def close(self) -> None:
        """Let go of the database."""
        self.database.dispose()
