"""Stands in for every stage: sleeps instead of computing, and keeps a trace that nothing is ever taken from.

With BENCH_BURN=1 it keeps one core as busy as a training would. Run by path, without the packages, so that a campaign
costs little: the trace holds `begin` and `end` of every attempt. With BENCH_RECORDER=real it becomes the real recorder,
which `captures.trace` in the data folder notes first, a line a process.
"""

import json
import os
import signal
import sys
import time
from pathlib import Path
from typing import Any


def main() -> None:
    """`record ... --out REC` or `reconstruct REC --out RUN --stage NAME [--again N]`; SIGTERM ends it."""
    command, *arguments = sys.argv[1:]
    if command in ("record", "finalise") and os.environ.get("BENCH_RECORDER") == "real":
        _become_recorder(
            command, Path(arguments[arguments.index("--out") + 1] if command == "record" else arguments[0])
        )
    if command == "reconstruct":
        arguments = arguments[1:]
    flags = dict(zip(arguments[::2], arguments[1::2], strict=False))
    out = Path(flags["--out"])
    if command == "record":
        aside = out.with_name(f".{out.name}.partial")
        aside.mkdir(exist_ok=True)
        (aside / "recording.json").write_text("{}")
        aside.rename(out)
        return
    out.mkdir(exist_ok=True)
    _stage(out, flags["--stage"], int(flags.get("--again", "0")))


def _become_recorder(command: str, recording: Path) -> None:
    _append(recording.parents[1] / "captures.trace", f"{command} {recording.name}")
    os.execv(sys.executable, [sys.executable, "-P", "-m", "server.cli", *sys.argv[1:]])


def _stage(run: Path, stage: str, again: int) -> None:
    told: list[int] = []
    signal.signal(signal.SIGTERM, lambda number, frame: told.append(number))
    document = _document(run, stage, again)
    checkpoint = run / f"{stage}.json"
    state = {"done": 0, "attempt": document["attempt"]}
    if checkpoint.exists() and (kept := json.loads(checkpoint.read_text()))["attempt"] == document["attempt"]:
        state = kept
    steps = 20 if stage == "train" else 3
    _trace(run, f"begin {stage} {again} {0 if stage in document['seconds'] else max(1, steps - state['done'])}")
    while state["done"] < steps:
        _step(float(os.environ.get("BENCH_STEP_S", "0.05")))
        state["done"] += 1
        _write(checkpoint, state)
        event = {"event": "progress", "stage": stage, "fraction": state["done"] / steps, "message": "asleep"}
        sys.stderr.write(json.dumps(event) + "\n")
        if told:
            sys.exit(143)
    if stage == "report":
        _write(run / "report.html", "x" * 100_000)
        _write(run / "metrics.json", {"psnr_db": 30.0})
        document["status"] = "finished"
    document["seconds"][stage] = 1.0
    _write(run / "run.json", document)  # the stage is finished from here on
    _trace(run, f"end {stage} {again} 0")


def _step(seconds: float) -> None:
    if os.environ.get("BENCH_BURN") != "1":
        time.sleep(seconds)
        return
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        sum(range(10_000))


def _document(run: Path, stage: str, again: int) -> dict[str, Any]:
    """run.json; a restart with a higher number forgets its stage and those after it first."""
    path = run / "run.json"
    document = json.loads(path.read_text()) if path.exists() else {"status": "unfinished", "attempt": 0, "seconds": {}}
    if again > document["attempt"]:
        names = list(document["seconds"])
        kept = names[: names.index(stage)] if stage in names else names
        document = {"status": "unfinished", "attempt": again, "seconds": {name: 1.0 for name in kept}}
        _write(path, document)
    return document


def _trace(run: Path, text: str) -> None:
    _append(run.parent / "trace.txt", text)


def _append(path: Path, text: str) -> None:
    line = f"{text} {os.getpid()}\n".encode()
    descriptor = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT)
    os.write(descriptor, line)
    os.close(descriptor)


def _write(path: Path, document: object) -> None:
    aside = path.with_suffix(".partial")
    try:
        aside.write_text(json.dumps(document))
        aside.replace(path)
    except OSError as error:
        aside.unlink(missing_ok=True)
        sys.exit(f"{path.name}: {error.strerror}")


if __name__ == "__main__":
    main()
