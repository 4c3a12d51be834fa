"""Measures what more workers bring to a long recording.

Two workers of one core each reconstruct one that is recorded here. More of them than there are cores go through the
schedule of a recording that `bench long` has measured: the queue, the workers and the database are real, and each task
sleeps for as long as it took there.
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import click
import httpx
from maintenance.deployment import STAGE, Deployment
from maintenance.waiting import wait_for

from acquisition.bench_document import BenchDocument
from acquisition.durable import write_json
from acquisition.revision import code_revision
from rigs.errors import Spike4dgsError
from server.client import RefusedError, ServiceClient
from server.schemas.captures import CaptureRequest
from server.schemas.job_types import ReconstructRequest

REAL = (sys.executable, "-P", "-m", "server.cli")
RIG, HOLDOUT, LIMIT_S = "lab3x3", "cam11", 7200.0
UP_S = 1200.0  # in which all workers have come up; 32 of them take minutes on two cores
STAGES = ("plan", "poses", "images", "points", "report")  # beside the training


def tasks_of(long: Mapping[str, Any]) -> tuple[str, dict[str, float]]:
    """Return the longest recording of a document of `bench long`, and the seconds of each of its tasks by name."""
    whole = max((row for row in long["rows"] if row["part"] == "whole"), key=lambda row: row["planes"])
    spans = [row for row in long["rows"] if row["part"] == "span" and row["clip"] == whole["clip"]]
    by_span: dict[int, float] = defaultdict(float)
    for place, row in enumerate(spans):  # those of one span are one task
        by_span[row.get("span", place)] += row.get("seconds", 0.0)
    moving = [seconds for seconds in by_span.values() if seconds]
    seconds = {stage: whole[f"seconds.{stage}"] for stage in STAGES}
    still = whole["seconds.train"] - sum(moving)
    return whole["clip"], seconds | {"still": still} | {f"{n:06d}": s for n, s in enumerate(moving)}


def least_s(tasks: Mapping[str, float], workers: int) -> float:
    """Return the seconds that no schedule is below: of the tasks that wait for one another, and of the spans.

    Spans take as long as the longest, as their even share, and as two that must share a worker where there are more.
    """
    waiting = sum(seconds for name, seconds in tasks.items() if not name.isdigit())
    spans = sorted((seconds for name, seconds in tasks.items() if name.isdigit()), reverse=True)
    return waiting + max(sum(spans) / workers, sum(spans[:1]), sum(spans[workers - 1 : workers + 1]))


def played(folder: Path, tasks: Mapping[str, float], workers: int) -> dict[str, Any]:
    """Return the row of a schedule: seconds from the order to the end, with tasks that sleep."""
    spans = sum(name.isdigit() for name in tasks)
    words = {"BENCH_SECONDS": json.dumps(tasks)}
    deployment = Deployment(folder / "data", postgresql=workers > 1, dead_s=30.0, stage=STAGE, environment=words)
    found = _timed(deployment, workers, 5, {"seed": spans}, pinned=False)
    least = {"tasks_s": sum(tasks.values()), "least_s": least_s(tasks, workers), "spans": spans}
    return {"part": "played", "workers": workers, **least, **found}


def worked(folder: Path, workers: int, planes: int, steps: int) -> dict[str, Any]:
    """Return the row of a reconstruction by workers of one core each, that record it first."""
    rigs = {RIG: {"rig": RIG, "devices": "mock:carried_boxes?truth_every=100"}}
    words = {"SPIKE4DGS_RIGS": json.dumps(rigs)}
    deployment = Deployment(folder / "data", postgresql=False, dead_s=30.0, stage=REAL, environment=words)
    found = _timed(deployment, workers, planes, {"steps": steps, "seed": 1, "holdout": HOLDOUT}, pinned=True)
    return {"part": "worked", "workers": workers, "planes": planes, "steps": steps, **found}


def _timed(
    deployment: Deployment, workers: int, ticks: int, options: dict[str, Any], *, pinned: bool
) -> dict[str, Any]:
    """Return the seconds that a reconstruction takes, and the dB of one that is scored."""
    names = [f"w{number}" for number in range(workers)]
    try:
        for number, name in enumerate(["api", *names]):
            deployment.start(name)
            if pinned and number:
                cores = sorted(os.sched_getaffinity(0))
                os.sched_setaffinity(deployment.processes[name].pid, {cores[number % len(cores)]})
        with ServiceClient.at(deployment.address) as client:
            wait_for(lambda: _are_up(client, workers), limit_s=UP_S)
            capture = client.start_capture(RIG, CaptureRequest(ticks=ticks)).id
            wait_for(lambda: client.capture(capture).status == "done", limit_s=LIMIT_S)
            began = time.monotonic()
            job = client.submit(ReconstructRequest.model_validate({"capture": capture, **options})).id
            wait_for(lambda: client.job(job).status not in ("queued", "running"), limit_s=LIMIT_S)
            seconds, ended = time.monotonic() - began, client.job(job)
            if ended.status != "done":
                raise Spike4dgsError(f"found a job that is {ended.status}: {ended.error}", "one that is done")
            metrics = json.loads((deployment.data / "jobs" / job / "run" / "metrics.json").read_text())
    finally:
        deployment.close()
    return {"seconds": seconds, "psnr_db": metrics["psnr_db"]} if pinned else {"seconds": seconds}


def _are_up(client: ServiceClient, workers: int) -> bool:
    try:
        return len(client.workers()) == workers
    except (RefusedError, httpx.TransportError):
        return False


def summarise(rows: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """Return what each number of workers takes of the seconds of one, and the least they can, where it is known."""
    single = {row["part"]: row["seconds"] for row in rows if row["workers"] == 1}
    several = [row for row in rows if row["workers"] > 1 and row["part"] in single]
    summary = {f"{row['part']}.{row['workers']}": row["seconds"] / single[row["part"]] for row in several}
    ideal = [row for row in several if "least_s" in row]
    return summary | {f"{row['part']}.{row['workers']}.least": row["least_s"] / row["tasks_s"] for row in ideal}


def _rows_of(out: Path) -> list[dict[str, Any]]:
    """Return the rows that an interrupted measurement of this revision has left; none otherwise."""
    found = json.loads(out.read_text()) if out.exists() else {}
    return found["rows"] if found.get("revision") == code_revision() else []


@click.command()
@click.option("--long", "measured", type=click.Path(path_type=Path, exists=True), default="tests/benchmarks/long.json")
@click.option("--workers", "many", type=int, multiple=True, default=(8, 32), show_default=True)
@click.option("--planes", default=4000, show_default=True, help="That two workers reconstruct.")
@click.option("--steps", default=2000, show_default=True, help="Of their training.")
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), required=True)
def main(measured: Path, many: tuple[int, ...], planes: int, steps: int, out: Path) -> None:
    """Measure all of it in turn, half an hour, and write OUT after each measurement; what is in OUT is not repeated."""
    clip, tasks = tasks_of(json.loads(measured.read_text()))
    document = BenchDocument("sharing", _rows_of(out))
    document.omissions.append(f"the tasks of {clip} sleep; its workers share one machine")
    todo = [("worked", n, lambda at, n=n: worked(at, n, planes, steps)) for n in (1, 2)]
    todo += [("played", n, lambda at, n=n: played(at, tasks, n)) for n in (1, *many)]
    for part, workers, measure in todo:
        if any((row["part"], row["workers"]) == (part, workers) for row in document.rows):
            continue
        with tempfile.TemporaryDirectory(prefix="spike4dgs-sharing-") as folder:
            try:
                document.rows.append(measure(Path(folder)))
            except AssertionError as error:  # a wait that was in vain
                document.omissions.append(f"{part} by {workers} workers: {error}")
        click.echo(json.dumps(document.rows[-1]))
        document.summary = summarise(document.rows)
        write_json(out, document.to_json())
    for name, value in document.summary.items():
        click.echo(f"{name:12} {value:.3f}")


if __name__ == "__main__":
    main()
