"""Who may ask: tokens, of which only a digest is kept."""

from __future__ import annotations

import hashlib
import secrets
from dataclasses import dataclass
from typing import Literal

import sqlalchemy as sa

from server.errors import TokenError
from server.store.database import lock_writers
from server.store.entries import now
from server.store.tables import tokens

Role = Literal["viewer", "operator"]
_PREFIX = "s4d_"  # so that one left in a file or a log is recognised
_BYTES = 32


@dataclass(frozen=True)
class Token:
    """A token as it is kept; a viewer reads, an operator does everything."""

    id: str
    digest: str
    role: Role
    name: str
    created: str


class Tokens:
    """The table of tokens."""

    def __init__(self, engine: sa.Engine) -> None:
        self._engine = engine

    def add(self, name: str, role: Role) -> str:
        """Make a token; what is returned is kept nowhere. Raises TokenError where the name is taken."""
        secret = _PREFIX + secrets.token_urlsafe(_BYTES)
        row = Token(secrets.token_hex(8), digest_of(secret), role, name, now().isoformat("T", "seconds"))
        with self._engine.begin() as connection:
            lock_writers(connection)
            if connection.scalar(sa.select(tokens.c.id).where(tokens.c.name == name)):
                raise TokenError(f"found a token {name} already", "a new name", "remove it or choose another")
            connection.execute(tokens.insert(), vars(row))
        return secret

    def all(self) -> list[Token]:
        """All tokens, by name."""
        with self._engine.connect() as connection:
            return [Token(**row) for row in connection.execute(sa.select(tokens).order_by(tokens.c.name)).mappings()]

    def remove(self, name: str) -> None:
        """Forget a token; raises TokenError where there is none of the name."""
        with self._engine.begin() as connection:
            lock_writers(connection)
            if not connection.execute(tokens.delete().where(tokens.c.name == name)).rowcount:
                raise TokenError(f"found no token {name}", "one that spike4dgs token list shows")


def digest_of(secret: str) -> str:
    """SHA-256 of a token, in hexadecimal.

    A slow hash is for passwords, which people choose and others guess. A token is 256 random bits: nobody guesses one
    at any speed, and every request pays for the hash.
    """
    return hashlib.sha256(secret.encode(errors="surrogateescape")).hexdigest()
