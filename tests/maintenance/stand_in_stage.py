"""Stands in for every stage: sleeps instead of computing, and keeps a trace that nothing is ever taken from.

With BENCH_BURN=1 it keeps one core as busy as a training would. Run by path, without the packages, so that a campaign
costs little: the trace holds `begin` and `end` of every attempt. A training has as many spans as `--seed` says, which
are learnt apart, each with a line `part`. A part fails, refuses its input or finds no room while the job's folder has
`fail-NAME`, `refuse-NAME` or `fill-NAME`, and stands still while it has `hold-NAME`. A step takes BENCH_STEP_S, but
those of what the JSON object BENCH_SECONDS names take so many seconds together. With BENCH_RECORDER=real it becomes the
real recorder, which `captures.trace` in the data folder notes first, a line a process.
"""

import json
import os
import shutil
import signal
import sys
import time
from pathlib import Path
from typing import Any


def main() -> None:
    """`record ... --out REC` or `reconstruct REC --out RUN --stage NAME [--again N] [--part P]`; SIGTERM ends it."""
    command, *arguments = sys.argv[1:]
    if command == "verify":
        sys.stdout.write(json.dumps({"sound": True}))
        return
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
    if "--part" in flags:
        return _part(out, flags["--part"], int(flags.get("--again", "0")))
    return _stage(out, flags["--stage"], int(flags.get("--again", "0")), int(flags.get("--seed", "0")))


def _become_recorder(command: str, recording: Path) -> None:
    _append(recording.parents[1] / "captures.trace", f"{command} {recording.name}")
    os.execv(sys.executable, [sys.executable, "-P", "-m", "server.cli", *sys.argv[1:]])


def _stage(run: Path, stage: str, again: int, spans: int) -> None:
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
        _step(stage, steps)
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
    if stage == "train":
        _say_given_up(run)
    if stage == "images" and spans:
        names = ["still", *(f"{number:06d}" for number in range(spans))]
        (run / "images").mkdir(exist_ok=True)
        _write(run / "images" / "parts.json", [{"name": name} for name in names])
    document["seconds"][stage] = 1.0
    _write(run / "run.json", document)  # the stage is finished from here on
    _trace(run, f"end {stage} {again} 0")


def _part(run: Path, name: str, again: int) -> None:
    """Learn one part: ten steps, and a file that the first process with all of them makes."""
    attempt = _document(run, "train", again)["attempt"]
    (run / "spans").mkdir(exist_ok=True)
    _trace(run, f"part {name} {again} {attempt}")
    for done in range(10):
        _step(name, 10)
        while (run.parent / f"hold-{name}").exists():
            time.sleep(0.05)
        event = {"event": "progress", "stage": "train", "fraction": (done + 1) / 10, "message": f"{name} asleep"}
        sys.stderr.write(json.dumps(event) + "\n")
    for word in ("fail", "refuse", "fill"):
        if (run.parent / f"{word}-{name}").exists():
            _fail(word, name)
    file = run / "spans" / f"{name}.pt"
    aside = file.with_suffix(f".{os.getpid()}")
    aside.write_text(str(os.getpid()))
    try:
        os.link(aside, file)
    except FileExistsError:
        sys.stderr.write(f"part {name}: dropped\n")
    aside.unlink()


def _say_given_up(run: Path) -> None:
    for mark in sorted((run / "spans").glob("*.failed.json")):
        failure = json.loads(mark.read_text())
        if mark.name.startswith("still"):
            event = {"event": "error", "found": failure["reason"], "expected": "", "do": "", "where": ""}
            sys.exit(json.dumps(event | {"bad_input": failure["bad_input"]}))
        message = f"{mark.name} after {failure['tries']}: {failure['reason']}"
        sys.stderr.write(json.dumps({"event": "warning", "message": message}) + "\n")


def _fail(word: str, name: str) -> None:
    parts = {"found": f"found a fault in {name}", "expected": "none", "do": "mend it", "where": ""}
    kind = "DiskError" if word == "fill" else "BadRunError"
    event = {"event": "error", "kind": kind, **parts, "bad_input": word == "refuse", "exit_code": 1}
    sys.exit(json.dumps(event))


def _step(name: str, steps: int) -> None:
    known = json.loads(os.environ.get("BENCH_SECONDS", "{}"))
    seconds = known[name] / steps if name in known else float(os.environ.get("BENCH_STEP_S", "0.05"))
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
        if "train" not in kept:
            shutil.rmtree(run / "spans", ignore_errors=True)
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
