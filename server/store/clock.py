"""Tells the time of the database, which the processes of all machines have in common."""

import logging
import threading
import time
from collections.abc import Callable

import sqlalchemy as sa
from sqlalchemy.exc import SQLAlchemyError

_READ_EVERY_S = 60.0
_OFF_S = 5.0  # least difference worth a warning
_LOG = logging.getLogger(__name__)


class DatabaseClock:
    """Seconds since 1970 by the clock of a PostgreSQL server; on SQLite, which one machine has, by this machine's own.

    The server's is read once a minute and counted on in between. Where it cannot be read, the last reading goes on.
    """

    def __init__(self, engine: sa.Engine, own: Callable[[], float] = time.time) -> None:
        self._engine = engine
        self._own = own
        self._shared = engine.dialect.name == "postgresql"
        self._ahead_s = 0.0  # of this machine's monotonic clock
        self._read_at: float | None = None
        self._reading = threading.Lock()
        self._warned = False

    def __call__(self) -> float:
        """Return the time; raises SQLAlchemyError where it was never read and cannot be."""
        if not self._shared:
            return self._own()
        with self._reading:
            if self._read_at is None or time.monotonic() - self._read_at > _READ_EVERY_S:
                self._read()
            return time.monotonic() + self._ahead_s

    def _read(self) -> None:
        known, self._read_at = self._read_at is not None, time.monotonic()
        try:
            with self._engine.connect() as connection:
                now = float(connection.exec_driver_sql("SELECT extract(epoch FROM clock_timestamp())").scalar_one())
        except SQLAlchemyError:
            if not known:
                self._read_at = None
                raise
            return
        self._ahead_s = now - time.monotonic()
        off_s = self._own() - now
        if abs(off_s) > _OFF_S and not self._warned:
            way = "ahead of" if off_s > 0 else "behind"
            _LOG.warning("this machine's clock is %.0f s %s the database's, which counts; set it", abs(off_s), way)
            self._warned = True
