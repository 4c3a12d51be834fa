"""Progress on standard error: a bar on a terminal, a line every two seconds elsewhere, JSON lines for a supervisor."""

import contextlib
import json
import os
import sys
import time
from collections.abc import Callable

from tqdm import tqdm

from acquisition.progress import Progress
from rigs.errors import Spike4dgsError

JSON_PROGRESS = "SPIKE4DGS_PROGRESS"  # set to "json" by the service around a stage's process


def progress_of(name: str) -> Progress:
    """Return a reporter of the work `name`, in the form that fits where standard error goes."""
    if os.environ.get(JSON_PROGRESS) == "json":
        told = {"event": "progress", "stage": name}
        return _throttled(lambda f, message: _say(json.dumps({**told, "fraction": f, "message": message})), every_s=0.2)
    if sys.stderr.isatty():
        return _bar(name)
    return _throttled(lambda fraction, message: _say(f"{name} {fraction:4.0%} {message}"), every_s=2.0)


def report_error(error: Spike4dgsError, exit_code: int) -> None:
    """Report the parts of an error to the service around a stage's process, and to nobody else."""
    if os.environ.get(JSON_PROGRESS) == "json":
        parts = {name: getattr(error, name) for name in ("found", "expected", "do", "where")}
        known = {"kind": type(error).__name__, "exit_code": exit_code, "bad_input": error.bad_input}
        _say(json.dumps({"event": "error", **parts, **known}))


def warn(text: str) -> None:
    """Tell what a person should know before trusting the result: to the service, or in a line of its own."""
    as_json = os.environ.get(JSON_PROGRESS) == "json"
    _say(json.dumps({"event": "warning", "message": text}) if as_json else f"spike4dgs: warning: {text}")


def _say(line: str) -> None:
    """Write a line, also where nobody is left to read it: the work goes on without its reader."""
    with contextlib.suppress(BrokenPipeError):
        print(line, file=sys.stderr, flush=True)  # noqa: T201


def _bar(name: str) -> Progress:
    bar = tqdm(total=1.0, desc=name, bar_format="{desc} {percentage:3.0f}% |{bar}| {elapsed} {postfix}", leave=True)

    def report(fraction: float, message: str) -> None:
        *above, last = message.splitlines() or [""]
        for line in above:
            bar.write(line, file=sys.stderr)
        bar.set_postfix_str(last, refresh=False)
        bar.update(min(fraction, 1.0) - bar.n)
        if fraction >= 1:
            bar.close()

    return report


def _throttled(emit: Callable[[float, str], None], every_s: float) -> Progress:
    last = -float("inf")

    def report(fraction: float, message: str) -> None:
        nonlocal last
        now = time.monotonic()
        if now - last >= every_s or fraction >= 1:
            last = now
            emit(fraction, message)

    return report
