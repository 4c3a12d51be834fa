"""Keys that a client may send again, each with what it asked for and the entries that were made of it."""

import hashlib
from collections.abc import Callable

from server.errors import IdempotencyError
from server.store.records import Records
from server.store.tables import UsedKey, idempotency

_KEPT_S = 7 * 24 * 3600


class Idempotency(Records[UsedKey]):
    """The table of keys; a key is kept for a week."""

    table, row = idempotency, UsedKey

    def prune(self) -> None:
        """Forget keys older than a week."""
        self.delete(idempotency.c.at < self._clock() - _KEPT_S)

    def claim(self, key: str, asked: str, make_ids: Callable[[], list[str]]) -> list[str]:
        """Return the ids that belong to `key`: those of its first use, or new ones.

        Raises IdempotencyError where the key came with another request before.
        """
        with self.writing() as connection:
            connection.execute(idempotency.delete().where(idempotency.c.at < self._clock() - _KEPT_S))
            found = self.rows(connection, idempotency.c.key == key)
            if not found:
                found = [UsedKey(key, _digest(asked), make_ids(), self._clock())]
                connection.execute(idempotency.insert(), vars(found[0]))
        _expect_same(found[0], asked)
        return found[0].entries

    def seen(self, key: str, asked: str) -> bool:
        """Return whether the request has succeeded under `key` before; raises IdempotencyError as `claim`."""
        found = self.select(idempotency.c.key == key)
        for used in found:
            _expect_same(used, asked)
        return bool(found)

    def note(self, key: str, asked: str) -> None:
        """Note that a request that makes no entry has succeeded under `key`."""
        self.claim(key, asked, list)


def _digest(asked: str) -> str:
    return hashlib.sha256(asked.encode()).hexdigest()


def _expect_same(used: UsedKey, asked: str) -> None:
    if used.digest != _digest(asked):
        found = f"found the Idempotency-Key {used.key[:60]} with another request than before"
        raise IdempotencyError(found, "the same one", "choose a new key for a new request")
