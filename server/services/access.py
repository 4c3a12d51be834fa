"""Finds the token that a request carries, and whether it allows the request."""

import hmac
import threading
import time
from collections.abc import Callable

from server.errors import ExposedError, ForbiddenError, UnauthorizedError
from server.settings import ServiceSettings
from server.store.tables import Token
from server.store.tokens import Tokens, digest_of

_FRESH_S = 2.0
_READS = ("GET", "HEAD", "OPTIONS")


class AccessService:
    """Compares the secrets of requests with the tokens that are kept, which are read again every two seconds."""

    def __init__(self, tokens: Tokens, settings: ServiceSettings, clock: Callable[[], float] = time.monotonic) -> None:
        self._tokens = tokens
        self._exposed = settings.exposed
        self._clock = clock
        self._lock = threading.Lock()
        self._known: list[Token] = []
        self._read_at: float | None = None

    @property
    def stale(self) -> bool:
        """Return whether the next answer needs the database."""
        return self._read_at is None or self._clock() - self._read_at >= _FRESH_S

    @property
    def guards(self) -> bool:
        """Return whether a request needs a token: as soon as there is any, and where others reach the service."""
        return bool(self._known) or self._exposed

    def refresh(self) -> None:
        """Read the tokens again, where that is due."""
        with self._lock:
            if self.stale:
                at = self._clock()
                self._known = self._tokens.all()
                self._read_at = at

    def admit(self, method: str, authorization: str | None) -> Token | None:
        """Return the token of a request, None where none is needed.

        A token is needed as soon as there is any, and always where the service may be reached from elsewhere. Raises
        UnauthorizedError without a known one, and ForbiddenError where a viewer would change something.
        """
        if not self.guards:
            return None
        token = self._find(authorization or "")
        if token.role != "operator" and method not in _READS:
            raise ForbiddenError(f"found the viewer {token.name}", f"an operator's token for {method[:20]}")
        return token

    def check_exposure(self) -> None:
        """Raise ExposedError where the service would be reached from elsewhere and has no token."""
        self.refresh()
        if self._exposed and not self._known:
            raise ExposedError(
                "found no token",
                "one before the service is reached from elsewhere",
                "run spike4dgs token add NAME --role operator",
            )

    def _find(self, authorization: str) -> Token:
        scheme, _, secret = authorization.partition(" ")
        given = digest_of(secret.strip()) if scheme.lower() == "bearer" else ""
        found = [token for token in self._known if hmac.compare_digest(token.digest, given)]
        if not found:
            fault = "found another token" if given else "found no token"
            raise UnauthorizedError(fault, "Authorization: Bearer and a token of this service")
        return found[0]
