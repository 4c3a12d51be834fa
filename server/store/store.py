"""Everything that is remembered, opened once by each process."""

import time
from collections.abc import Callable
from contextlib import ExitStack

from server.settings import ServiceSettings
from server.store.artefacts import Artefacts
from server.store.calibrations import Calibrations
from server.store.clock import DatabaseClock
from server.store.database import prepare_database
from server.store.disk import Disk
from server.store.entries import Entries
from server.store.events import Events
from server.store.files import DataFolder, make_private, shared
from server.store.idempotency import Idempotency
from server.store.known_rigs import KnownRigs
from server.store.rig_files import RigFiles
from server.store.soundness import DatabaseError
from server.store.tokens import Tokens
from server.store.uploads import Uploads
from server.store.webhooks import Deliveries, Webhooks
from server.store.workers import Workers


class Store:
    """The tables and folders of one service, opened, created or brought up to date.

    `pause` is as in `prepare_database`. Raises DatabaseError.
    """

    def __init__(self, settings: ServiceSettings, pause: Callable[[float], object] = time.sleep) -> None:
        make_private(settings.data)
        with ExitStack() as opened:
            try:
                opened.enter_context(shared(settings.data))
            except BlockingIOError as error:
                raise DatabaseError("found it being restored", "that done", where=settings.data) from error
            self.database = prepare_database(settings, pause)
            for path in settings.data.glob("*.sqlite*"):
                path.chmod(0o600)
            self._opened = opened.pop_all()
        self.clock = DatabaseClock(self.database)
        self.folder = DataFolder(settings.data)
        self.disk = Disk(settings.data, settings.keep_free_bytes)
        self.entries = Entries(self.database, self.clock)
        self.events = Events(self.database, self.clock)
        self.artefacts = Artefacts(self.database, self.clock)
        self.idempotency = Idempotency(self.database, self.clock)
        self.workers = Workers(self.database, self.clock, settings.dead_s)
        self.calibrations = Calibrations(self.database, self.clock)
        self.known_rigs = KnownRigs(self.database, self.clock)
        self.rig_files = RigFiles(self.folder, self.calibrations, self.known_rigs)
        self.uploads = Uploads(self.database, self.clock)
        self.tokens = Tokens(self.database, self.clock)
        self.webhooks = Webhooks(self.database, self.clock)
        self.deliveries = Deliveries(self.database, self.clock)

    def close(self) -> None:
        """Let go of the database."""
        self.database.dispose()
        self._opened.close()
