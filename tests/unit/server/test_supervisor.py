import asyncio
import signal
import sys
from collections.abc import Callable
from pathlib import Path

import psutil
import pytest

from server.store.files import is_locked
from server.work.supervisor import Control, StageError, supervise


def run(
    code: str,
    folder: Path,
    *,
    grace_s: float = 5.0,
    cancel_when: str | None = None,
    finished: Path | None = None,
    is_due: Callable[[], bool] = lambda: True,
    warnings: list[str] | None = None,
) -> list[tuple[float, str]]:
    """Supervise `python -c code`, cancelling once a progress message equals `cancel_when`."""
    reports: list[tuple[float, str]] = []
    warnings = [] if warnings is None else warnings

    async def main() -> None:
        told = asyncio.Event()

        def on_progress(fraction: float, message: str) -> None:
            reports.append((fraction, message))
            if message == cancel_when:
                told.set()

        work = asyncio.create_task(
            supervise(
                [sys.executable, "-c", code],
                folders=[folder],
                log=folder / "log.txt",
                on_progress=on_progress,
                on_warning=warnings.append,
                grace_s=grace_s,
                finished=finished,
                is_due=is_due,
            )
        )
        if cancel_when is not None:
            await told.wait()
            work.cancel()
            work.cancel()
        await work

    asyncio.run(main())
    return reports


REPORT = """
import json, sys, time, signal, os
def note(text):
    print(text, file=sys.stderr, flush=True)
def report(fraction, message):
    note(json.dumps({"event": "progress", "stage": "s", "fraction": fraction, "message": message}))
"""


def test_progress_is_reported_and_the_rest_is_logged(tmp_path: Path) -> None:
    code = REPORT + "report(0.5, 'half'); note('a note'); print('data'); report(7, 'all'); report(float('nan'), 'odd')"
    assert run(code, tmp_path) == [(0.5, "half"), (1.0, "all"), (0.0, "odd")]
    assert set((tmp_path / "log.txt").read_text().split("\n")) == {"a note", "data", ""}


@pytest.mark.parametrize(
    ("code", "message"),
    [
        (
            "import sys; print('{\"event\": 1}', file=sys.stderr); sys.exit('found a, expected b')",
            "found a, expected b",
        ),
        (
            "import sys; from rigs.errors import RigError; from server.cli import main\n"
            "def cli(obj): raise RigError('found a', 'b', 'do c', where='d')\n"
            "main.cli = cli; sys.argv[1:] = []; main.main()",
            "d: found a, expected b; do c",
        ),
        (
            "import sys; from server.cli import main\n"
            "def cli(obj): open('/nowhere/at/all')\n"
            "main.cli = cli; sys.argv[1:] = []; main.main()",
            "/nowhere/at/all: No such file or directory",
        ),
        ("import sys; sys.exit(3)", "the stage ended with exit code 3 and no message"),
        ("import os; os.kill(os.getpid(), 9)", "the stage ended with SIGKILL and no message"),
        ("raise ValueError('odd')", "ValueError: odd"),
    ],
)
def test_a_failure_is_the_last_line(tmp_path: Path, code: str, message: str) -> None:
    with pytest.raises(StageError, match=f"^{message}$"):
        run(code, tmp_path)


def test_the_log_keeps_the_line_for_people_and_not_the_report(tmp_path: Path) -> None:
    code = "import sys; from server.cli import main; sys.argv[1:] = ['verify', '/nowhere']; main.main()"
    with pytest.raises(StageError) as caught:
        run(code, tmp_path)
    assert (tmp_path / "log.txt").read_text() == f"spike4dgs: {caught.value}\n"
    assert str(caught.value).startswith(f"{caught.value.where}: {caught.value.found}")


def test_a_line_without_end_is_not_kept_in_memory(tmp_path: Path) -> None:
    run("import sys; sys.stderr.write('x' * 300_000)", tmp_path)
    lines = (tmp_path / "log.txt").read_text().split("\n")
    assert sum(map(len, lines)) == 300_000
    assert len(lines) > 2


def test_cancelling_lets_the_process_finish_its_checkpoint(tmp_path: Path) -> None:
    code = REPORT + (
        "signal.signal(signal.SIGTERM, lambda *_: (time.sleep(0.2), open('done', 'w').close(), sys.exit(143)))\n"
        f"os.chdir({str(tmp_path)!r}); report(0, 'ready'); time.sleep(60)"
    )
    with pytest.raises(asyncio.CancelledError):
        run(code, tmp_path, cancel_when="ready")
    assert (tmp_path / "done").exists()
    assert not is_locked(tmp_path)


def test_a_process_that_ignores_the_request_is_killed(tmp_path: Path) -> None:
    code = REPORT + "signal.signal(signal.SIGTERM, signal.SIG_IGN); report(0, 'ready'); time.sleep(60)"
    with pytest.raises(asyncio.CancelledError):
        run(code, tmp_path, grace_s=0.3, cancel_when="ready")
    assert not is_locked(tmp_path)


def test_the_process_holds_the_lock_and_dies_with_its_parent(tmp_path: Path) -> None:
    child = REPORT + "report(0, 'ready'); open('pid', 'w').write(str(os.getpid())); time.sleep(60)"
    parent = f"""
import asyncio, os, signal, sys, time
from pathlib import Path
from server.work.supervisor import supervise
os.chdir({str(tmp_path)!r})
here = Path({str(tmp_path)!r})
def die(fraction, message):
    while not (here / "pid").exists() or not (here / "pid").read_text():
        time.sleep(0.01)
    os.kill(os.getpid(), signal.SIGKILL)
command = [sys.executable, "-c", {child!r}]
asyncio.run(supervise(command, folders=[here], log=here / "log.txt", on_progress=die, grace_s=5))
"""

    async def main() -> None:
        process = await asyncio.create_subprocess_exec(sys.executable, "-c", parent)
        assert await process.wait() == -signal.SIGKILL
        while is_locked(tmp_path):  # the successor's wait, which ends only when the orphan is gone
            await asyncio.sleep(0.01)

    asyncio.run(asyncio.wait_for(main(), 20))
    pid = int((tmp_path / "pid").read_text())
    assert not psutil.pid_exists(pid) or psutil.Process(pid).status() == psutil.STATUS_ZOMBIE


def test_a_locked_folder_is_waited_for(tmp_path: Path) -> None:
    order: list[str] = []

    async def one(name: str, sleep_s: float) -> None:
        code = REPORT + f"report(0, 'begin'); time.sleep({sleep_s}); report(1, 'end')"
        await supervise(
            [sys.executable, "-c", code],
            folders=[tmp_path],
            log=tmp_path / f"{name}.txt",
            on_progress=lambda fraction, message: order.append(message),
            grace_s=5,
        )

    async def main() -> None:
        await asyncio.gather(one("a", 0.3), one("b", 0.0))

    asyncio.run(main())
    assert order == ["begin", "end", "begin", "end"]


def test_a_command_is_not_run_again_once_it_left_its_mark(tmp_path: Path) -> None:
    mark = tmp_path / "finished"
    code = "import os; open(os.environ['SPIKE4DGS_FINISHED'], 'w').close(); os.kill(os.getpid(), 9)"
    with pytest.raises(StageError):
        run(code, tmp_path, finished=mark)
    run(code, tmp_path, finished=mark)


def test_what_is_not_due_is_not_begun(tmp_path: Path) -> None:
    locked: list[bool] = []

    def is_due() -> bool:
        locked.append(is_locked(tmp_path))
        return False

    run("raise SystemExit(3)", tmp_path, finished=tmp_path / "finished", is_due=is_due)
    assert locked == [True]
    assert not (tmp_path / "finished").exists()


def test_a_process_is_told_to_stop_when_it_can_hear_it(tmp_path: Path) -> None:
    """Stop was asked for before the process ran; before its first report SIGTERM would kill it."""
    code = REPORT + (
        "time.sleep(0.3); told = []; signal.signal(signal.SIGTERM, lambda *_: told.append(True)); report(0, 'armed')\n"
        "while not told: time.sleep(0.01)\n"
        "report(1, 'ended in order')"
    )
    control, messages = Control(tmp_path / "stop", tmp_path / "save"), []
    control.stop.touch()
    work = supervise(
        [sys.executable, "-c", code],
        folders=[tmp_path],
        log=tmp_path / "log.txt",
        on_progress=lambda fraction, message: messages.append(message),
        grace_s=5,
        control=control,
    )
    asyncio.run(work)
    assert messages == ["armed", "ended in order"]


def test_a_process_that_never_reports_is_told_to_stop_all_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("server.work.supervisor._START_S", 0.2)
    control = Control(tmp_path / "stop", tmp_path / "save")
    control.stop.touch()
    work = supervise(
        [sys.executable, "-c", "import time; time.sleep(60)"],
        folders=[tmp_path],
        log=tmp_path / "log.txt",
        on_progress=lambda fraction, message: None,
        grace_s=5,
        control=control,
    )
    with pytest.raises(StageError, match="SIGTERM"):
        asyncio.run(asyncio.wait_for(work, 20))


def test_a_warning_is_passed_on_and_is_no_line_of_the_log(tmp_path: Path) -> None:
    warnings: list[str] = []
    run(
        f"{REPORT}note(json.dumps({{'event': 'warning', 'message': 'mind the gap'}})); report(1, 'done')",
        tmp_path,
        warnings=warnings,
    )
    assert warnings == ["mind the gap"]
    assert (tmp_path / "log.txt").read_text() == ""
