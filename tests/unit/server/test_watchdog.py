"""Tests what systemd is told: that the service works, and nothing once its worker was given up."""

import asyncio
import socket
from types import SimpleNamespace

import pytest

from server.services.watchdog import Watchdog


@pytest.fixture
def heard(tmp_path, monkeypatch):
    """Return a function that lists what was told until now."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(str(tmp_path / "notify"))
        systemd.setblocking(False)
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
        monkeypatch.setenv("WATCHDOG_USEC", "240000")

        def listed() -> list[str]:
            told = []
            while True:
                try:
                    told.append(systemd.recv(4096).decode())
                except BlockingIOError:
                    return told

        yield listed


def watch(keeper=None, seconds=0.2) -> None:
    async def run() -> None:
        watchdog = Watchdog(keeper)
        watchdog.start()
        await asyncio.sleep(seconds)
        watchdog.close()

    asyncio.run(run())


def test_a_service_that_works_says_so_again_and_again(heard) -> None:
    watch()
    first, *told, last = heard()
    assert (first, last) == ("READY=1", "STOPPING=1")
    assert told.count("WATCHDOG=1") >= 2


def test_one_whose_worker_was_given_up_is_silent_but_for_the_reason(heard) -> None:
    watch(SimpleNamespace(trouble="the worker ended", given_up=True))
    told = heard()
    assert "STATUS=the worker ended" in told
    assert "WATCHDOG=1" not in told


def test_one_whose_worker_starts_again_is_well(heard) -> None:
    watch(SimpleNamespace(trouble="the worker ended", given_up=False))
    assert "WATCHDOG=1" in heard()


def test_without_systemd_nothing_is_told(monkeypatch) -> None:
    monkeypatch.delenv("NOTIFY_SOCKET", raising=False)
    watch(seconds=0)


def test_one_that_does_not_listen_holds_nothing_up(heard, monkeypatch) -> None:
    monkeypatch.setenv("WATCHDOG_USEC", "3000")
    watch()
    assert 2 < len(heard()) < 200
