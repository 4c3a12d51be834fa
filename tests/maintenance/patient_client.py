"""A client that does what clients should: it asks again, with the same key, until it is answered."""

from __future__ import annotations

import time

import httpx

from server.errors import ServiceError

_PATIENCE_S = 120.0
_AGAIN_S = 0.2


class PatientClient:
    """A client of the service at `address`; counts its requests without an answer, and the answers by their code."""

    def __init__(self, address: str) -> None:
        self._http = httpx.Client(base_url=address, timeout=30, trust_env=False)
        self.unanswered = 0
        self.codes: dict[int, int] = {}

    def ask(self, method: str, path: str, body: object = None, key: str | None = None) -> httpx.Response:
        """Return the first answer that is no 503; raises ServiceError after two minutes without."""
        headers = {} if key is None else {"Idempotency-Key": key}
        deadline = time.monotonic() + _PATIENCE_S
        while time.monotonic() < deadline:
            answer = self._once(method, path, body, headers)
            if answer is not None and answer.status_code != 503:
                return answer
            time.sleep(_AGAIN_S)
        raise ServiceError(f"found no answer for {_PATIENCE_S:g} s", "one", where=f"{method} {path}")

    def told(self, path: str, body: object = None) -> bool:
        """Give an order; return whether it was taken. Raises ServiceError where the refusal is not 409."""
        answer = self.ask("POST", path, body)
        if answer.is_error and answer.status_code != 409:
            raise ServiceError(f"found {answer.status_code} {answer.text[:200]}", "202 or 409", where=path)
        return answer.is_success

    def probe(self) -> None:
        """Ask once, whatever the answer."""
        self._once("GET", "/jobs", None, {})

    def close(self) -> None:
        """Let go of the connections."""
        self._http.close()

    def _once(self, method: str, path: str, body: object, headers: dict[str, str]) -> httpx.Response | None:
        try:
            answer = self._http.request(method, f"/v1{path}", json=body, headers=headers)
        except httpx.TransportError:
            self.unanswered += 1
            return None
        self.codes[answer.status_code] = self.codes.get(answer.status_code, 0) + 1
        return answer
