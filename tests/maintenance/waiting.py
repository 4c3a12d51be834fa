"""Waits for what another process does."""

import time
from collections.abc import Callable


def wait_for(condition: Callable[[], bool], limit_s: float = 120.0) -> None:
    """Return once `condition` holds; raises AssertionError after `limit_s`."""
    deadline = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < deadline, f"waited for {limit_s:g} s in vain"
        time.sleep(0.05)
