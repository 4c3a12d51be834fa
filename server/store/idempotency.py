"""Keys that a client may send again, each with what it asked for and the entries that were made of it."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable

import sqlalchemy as sa

from server.errors import IdempotencyError
from server.store.database import lock_writers
from server.store.tables import idempotency

_KEPT_S = 7 * 24 * 3600


class Idempotency:
    """The table of keys; a key is kept for a week."""

    def __init__(self, engine: sa.Engine, clock: Callable[[], float] = time.time) -> None:
        self._engine = engine
        self._clock = clock

    def prune(self) -> None:
        """Forget keys older than a week."""
        with self._engine.begin() as connection:
            connection.execute(idempotency.delete().where(idempotency.c.at < self._clock() - _KEPT_S))

    def claim(self, key: str, asked: str, make_ids: Callable[[], list[str]]) -> list[str]:
        """The ids that belong to `key`: those of its first use, or new ones.

        Raises IdempotencyError where the key came with another request before.
        """
        digest = hashlib.sha256(asked.encode()).hexdigest()
        with self._engine.begin() as connection:
            lock_writers(connection)
            connection.execute(idempotency.delete().where(idempotency.c.at < self._clock() - _KEPT_S))
            found = connection.execute(sa.select(idempotency).where(idempotency.c.key == key)).mappings().first()
            if found is None:
                ids = make_ids()
                row = {"key": key, "digest": digest, "entries": ids, "at": self._clock()}
                connection.execute(idempotency.insert(), row)
                return ids
        if found["digest"] != digest:
            raise IdempotencyError(
                f"found the Idempotency-Key {key[:60]} with another request than before",
                "the same one",
                "choose a new key for a new request",
            )
        return found["entries"]
