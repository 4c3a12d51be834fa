"""Stages that are forks: what they say, how they end, and that none outlives what asked for it."""

import asyncio
import os
import signal
import sys
from multiprocessing import forkserver
from pathlib import Path

import psutil
import pytest
from maintenance.waiting import wait_for

from rigs.toml import catalog_rig, dump_rig
from server.store.files import is_locked
from server.work.supervisor import BadInputError, KilledError, supervise


@pytest.fixture
def endless(tmp_path: Path) -> list[str]:
    """A command that reports progress, and goes on for as long as nobody ends it."""
    rig = tmp_path / "rig.toml"
    rig.write_text(dump_rig(catalog_rig("lab3x3").scaled(40, 25)))
    return ["simulate", "--scene", "static", "--rig", str(rig), "--ticks", "1000000", "--out", str(tmp_path / "rec")]


def run(arguments: list[str], folder: Path, on_progress=lambda fraction, message: None, **how) -> None:
    work = supervise(
        arguments, folders=[folder], log=folder / "log.txt", on_progress=on_progress, grace_s=5.0, forks=True, **how
    )
    asyncio.run(asyncio.wait_for(work, 60))


def test_a_fork_prints_where_it_is_told(tmp_path: Path) -> None:
    run(["--version"], tmp_path, stdout=tmp_path / "said.txt", finished=tmp_path / "mark")
    assert "version" in (tmp_path / "said.txt").read_text()
    assert (tmp_path / "mark").exists()
    assert not is_locked(tmp_path)


def test_a_refusal_is_reported_in_parts(tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match="found no readable recording"):
        run(["verify", str(tmp_path / "nothing")], tmp_path)
    assert "spike4dgs: " in (tmp_path / "log.txt").read_text()


async def cancelled(arguments: list[str], folder: Path, told: asyncio.Event) -> None:
    work = asyncio.ensure_future(
        supervise(
            arguments,
            folders=[folder],
            log=folder / "log.txt",
            on_progress=lambda fraction, message: told.set(),
            grace_s=10.0,
            forks=True,
        )
    )
    await told.wait()
    assert is_locked(folder)
    work.cancel()
    work.cancel()
    with pytest.raises(asyncio.CancelledError):
        await work


def test_a_cancelled_fork_is_told_to_stop_and_is_gone(tmp_path: Path, endless: list[str]) -> None:
    asyncio.run(asyncio.wait_for(cancelled(endless, tmp_path, asyncio.Event()), 60))
    assert not is_locked(tmp_path)
    assert not (tmp_path / "rec").exists()


def test_one_that_is_cancelled_before_it_has_begun_leaves_no_lock(tmp_path: Path, endless: list[str]) -> None:
    async def main() -> None:
        work = asyncio.ensure_future(
            supervise(
                endless,
                folders=[tmp_path],
                log=tmp_path / "log.txt",
                on_progress=lambda fraction, message: None,
                grace_s=0.2,
                forks=True,
            )
        )
        await asyncio.sleep(0)
        work.cancel()
        with pytest.raises(asyncio.CancelledError):
            await work
        while is_locked(tmp_path):
            await asyncio.sleep(0.01)

    asyncio.run(asyncio.wait_for(main(), 60))


def test_a_killed_fork_is_an_error_that_names_the_signal(tmp_path: Path, endless: list[str]) -> None:
    with pytest.raises(KilledError, match="SIGKILL"):
        run(endless, tmp_path, lambda fraction, message: os.kill(holder(tmp_path), signal.SIGKILL))
    assert not is_locked(tmp_path)


def holder(folder: Path) -> int:
    """Return the fork that has `folder` open, which is not this process."""
    for one in psutil.Process().children(recursive=True):
        for link in Path(f"/proc/{one.pid}/fd").iterdir():
            if link.resolve() == folder:
                return one.pid
    raise AssertionError(f"nobody has {folder}")


def test_the_next_fork_begins_where_the_process_that_forks_was_killed(tmp_path: Path) -> None:
    run(["--version"], tmp_path)
    pid = forkserver._forkserver._forkserver_pid
    os.kill(pid, signal.SIGKILL)
    wait_for(lambda: psutil.Process(pid).status() == psutil.STATUS_ZOMBIE)
    run(["--version"], tmp_path, finished=tmp_path / "mark")
    assert (tmp_path / "mark").exists()


def test_a_fork_dies_with_the_process_that_asked_for_it(tmp_path: Path, endless: list[str]) -> None:
    parent = f"""
import asyncio, os, signal
from pathlib import Path
from server.work.supervisor import supervise
here = Path({str(tmp_path)!r})
def die(fraction, message):
    os.kill(os.getpid(), signal.SIGKILL)
asyncio.run(supervise({endless!r}, folders=[here], log=here / "log.txt", on_progress=die, grace_s=5, forks=True))
"""

    async def main() -> None:
        process = await asyncio.create_subprocess_exec(sys.executable, "-c", parent)
        assert await process.wait() == -signal.SIGKILL
        while is_locked(tmp_path):
            await asyncio.sleep(0.01)

    asyncio.run(asyncio.wait_for(main(), 60))
