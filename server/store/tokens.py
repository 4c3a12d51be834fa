"""Tokens, which allow requests; only a digest of each is kept."""

import hashlib
import secrets
from datetime import UTC, datetime

import sqlalchemy as sa

from server.errors import TokenError
from server.store.records import Records
from server.store.tables import Role, Token, tokens

_PREFIX = "s4d_"  # so that one left in a file or a log is recognised
_BYTES = 32


class Tokens(Records[Token]):
    """The table of tokens."""

    table, row = tokens, Token

    def add(self, name: str, role: Role) -> str:
        """Make a token; what is returned is kept nowhere. Raises TokenError where the name is taken."""
        secret = _PREFIX + secrets.token_urlsafe(_BYTES)
        created = datetime.fromtimestamp(self._clock(), UTC).isoformat("T", "seconds")
        with self.writing() as connection:
            if connection.scalar(sa.select(tokens.c.id).where(tokens.c.name == name)):
                raise TokenError(f"found a token {name} already", "a new name", "remove it or choose another")
            row = Token(secrets.token_hex(8), digest_of(secret), role, name, created)
            connection.execute(tokens.insert(), vars(row))
        return secret

    def all(self) -> list[Token]:
        """Return all tokens, by name."""
        return self.select(order=tokens.c.name)

    def remove(self, name: str) -> None:
        """Forget a token; raises TokenError where there is none of the name."""
        with self.writing() as connection:
            if not connection.execute(tokens.delete().where(tokens.c.name == name)).rowcount:
                raise TokenError(f"found no token {name}", "one that spike4dgs token list shows")


def digest_of(secret: str) -> str:
    """Return the SHA-256 of a token, in hexadecimal.

    A slow hash is for passwords, which people choose and others guess. A token is 256 random bits: nobody guesses one
    at any speed, and every request pays for the hash.
    """
    return hashlib.sha256(secret.encode(errors="surrogateescape")).hexdigest()
