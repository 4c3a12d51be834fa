"""Tells systemd that the service works, as `Type=notify` and `WatchdogSec=` of its unit ask; else does nothing."""

import asyncio
import os
import socket
from contextlib import suppress

from server.work.keeper import Keeper

_EVERY_S = 20.0  # where the unit sets no WatchdogSec


class Watchdog:
    """Reports from the event loop, so a loop that hangs falls silent, as does one whose worker was given up."""

    def __init__(self, keeper: Keeper | None) -> None:
        self._keeper = keeper
        self._address = os.environ.get("NOTIFY_SOCKET", "")
        self._every_s = float(os.environ.get("WATCHDOG_USEC", 3e6 * _EVERY_S)) / 3e6
        self._task: asyncio.Task[None] | None = None

    def start(self) -> None:
        """Report that the service is ready, and go on reporting; call it in the event loop."""
        if self._address:
            self._tell("READY=1")
            self._task = asyncio.get_running_loop().create_task(self._report())

    def close(self) -> None:
        """Stop reporting."""
        if self._task is not None:
            self._task.cancel()
            self._tell("STOPPING=1")

    async def _report(self) -> None:
        while True:
            trouble = self._keeper.trouble if self._keeper else None
            self._tell(f"STATUS={trouble or 'works'}")
            if self._keeper is None or not self._keeper.given_up:
                self._tell("WATCHDOG=1")
            await asyncio.sleep(self._every_s)

    def _tell(self, state: str) -> None:
        address = "\0" + self._address[1:] if self._address.startswith("@") else self._address
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as to_systemd:
            to_systemd.setblocking(False)
            with suppress(OSError):  # it is gone or does not read: requests matter more
                to_systemd.sendto(state.encode(), address)
