"""`demo`: record and reconstruct the simulated rig through the real service."""

import itertools
import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import click
import httpx
from pydantic import ValidationError

from acquisition.progress import silent
from acquisition.scenes.catalog import DEVELOPMENT
from reconstruction.report.table import score_table
from server.cli.options import PATH, several
from server.cli.output import columns
from server.cli.progress import progress_of
from server.client import ServiceClient
from server.errors import ServiceError
from server.schemas.captures import Capture, CaptureRequest
from server.schemas.job_types import ReconstructRequest
from server.schemas.jobs import Job
from server.work.leash import leashed, stop_process

SCENE = f"mock:{DEVELOPMENT[0]}"
HOLDOUT = "cam11"
BUDGET_S = 90.0
_POLL_S, _START_S, _STOP_S = 0.5, 60.0, 20.0
_W = TypeVar("_W", Capture, Job)


class DemoError(ServiceError):
    """The service of the demo, or one of its tasks, failed."""


class FolderError(ServiceError):
    """The folder that the demo was given exists already."""

    exit_code = 2


def _choice(name: str) -> Callable[[Any], Any]:
    """Return an option for a choice of a reconstruction, as the service offers it."""
    names = ReconstructRequest.model_json_schema()["properties"][name]["enum"]
    return click.option(f"--{name}", type=click.Choice(names), default="auto", show_default=True)


@click.command()
@click.option("--out", type=PATH, help="A new folder.  [default: runs/demo-N]")
@click.option("--ticks", type=click.IntRange(min=1), default=400, show_default=True, help="Planes to record.")
@click.option("--budget-s", type=float, help=f"Wall seconds to the final checkpoint.  [default: {BUDGET_S:g}]")
@click.option("--steps", type=click.IntRange(min=1), help="Training steps instead of a budget.")
@several(*map(_choice, ("model", "images", "init", "supervision")))
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True)
@click.option("--rig-error", type=float, default=0.0, show_default=True, help="As in simulate.")
def demo_command(
    out: Path | None, ticks: int, budget_s: float | None, steps: int | None, rig_error: float, **options: Any
) -> None:
    """Record the simulated rig through the service, and reconstruct the view of a camera that is held out."""
    to_record, to_do = _requests(ticks, budget_s, steps, options)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
    folder = _new_folder(out)
    try:
        with _service(folder, f"{SCENE}?rig_error={rig_error}") as client:
            (rig,) = client.rigs()
            capture = client.start_capture(rig.id, to_record)
            _follow(lambda: client.capture(capture.id))
            job = client.submit(to_do.model_copy(update={"capture": capture.id}))
            job = _follow(lambda: client.job(job.id))
            metrics = json.loads(client.artefact(job.id, "metrics.json"))
    except KeyboardInterrupt:
        raise SystemExit(128 + signal.SIGINT) from None
    table = score_table(metrics)
    headings = (f"centre view ({HOLDOUT})", *table.headings)
    click.echo(columns([headings, *((name, *cells) for name, cells in table.lines)], numbers=True))
    click.echo("\n" + "\n".join(f"{name}: {meaning}" for name, meaning in table.words.items()))
    run = folder / "jobs" / job.id / "run"
    seconds = ", ".join(f"{stage} {took:.1f} s" for stage, took in job.seconds.items())
    click.echo(f"\nstages: {seconds}\nreport: {run / 'report.html'}\norbit:  {run / 'orbit.mp4'}")


def _requests(
    ticks: int, budget_s: float | None, steps: int | None, choices: dict[str, Any]
) -> tuple[CaptureRequest, ReconstructRequest]:
    """Return the recording and the reconstruction, of a capture to be named; raises UsageError where they cannot be."""
    if steps is not None and budget_s is not None:
        raise click.UsageError("found both --budget-s and --steps, expected at most one")
    bound = BUDGET_S if steps is None and budget_s is None else budget_s
    wanted = {"capture": "", "holdout": HOLDOUT, "budget_s": bound, "steps": steps, **choices}
    try:
        return CaptureRequest(ticks=ticks, name="demo"), ReconstructRequest.model_validate(wanted)
    except ValidationError as error:
        fault = error.errors(include_url=False)[0]
        option = str(fault["loc"][0]).replace("_", "-")
        raise click.UsageError(f"--{option}: found {fault['input']}; {fault['msg']}") from error


def _follow(look: Callable[[], _W]) -> _W:
    """Show the progress of a capture or job until it is done. Raises DemoError with its message if it fails."""
    shown, reporter = (None, 1.0, ""), silent
    while True:
        found = look()
        if found.stage is not None and (found.stage, found.fraction, found.message) != shown:
            if found.stage != shown[0]:
                if shown[1] < 1:
                    reporter(1.0, shown[2])  # it ended between two looks
                reporter = progress_of(found.stage)
            reporter(found.fraction, found.message)
            shown = (found.stage, found.fraction, found.message)
        if found.status == "done":
            return found
        if found.status in ("failed", "cancelled"):
            raise DemoError(found.error) if found.error else DemoError(f"found {found.id} {found.status}", "it done")
        time.sleep(_POLL_S)


@contextmanager
def _service(folder: Path, devices: str) -> Iterator[ServiceClient]:
    """Yield a client of a new service with a worker over `folder` on a free port; stop both on the way out."""
    flags = ["--port", "0", "--data", str(folder), "--rig", "lab3x3", "--devices", devices, "--with-worker"]
    command = leashed([sys.executable, "-P", "-m", "server.cli", "serve", *flags], "SIGTERM")
    log = folder / "service.log"
    with log.open("w") as text:
        # In its own session, so that Ctrl-C reaches the demo only, which then stops the service in order.
        service = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=text, start_new_session=True)
    try:
        assert service.stdout is not None
        address = service.stdout.readline().decode().strip()
        if not address:
            said = log.read_text().strip().splitlines()
            raise DemoError(f"the service did not start: {said[-1] if said else 'it said nothing'}")
        with ServiceClient.at(address) as client:
            try:
                _await_worker(client, log)
                yield client
            except httpx.TransportError as error:
                raise DemoError(f"found the service gone ({error})", "it at work", f"{log} says why") from error
    finally:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # a second Ctrl-C must not leave anything running
        stop_process(service, _STOP_S)
        assert service.stdout is not None
        service.stdout.close()
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _await_worker(client: ServiceClient, log: Path) -> None:
    for _ in range(round(_START_S / _POLL_S)):
        if client.checks()["worker"].ok:
            return
        time.sleep(_POLL_S)
    raise DemoError(f"found no worker within {_START_S:g} s", "one", f"{log} says why")


def _new_folder(out: Path | None) -> Path:
    """Make the folder `out`, or else the first runs/demo-N that is not there yet."""
    if out is not None and out.exists():
        raise FolderError(f"found {out}", "a new folder", "give another --out")
    folder = out or next(path for n in itertools.count(1) if not (path := Path(f"runs/demo-{n}")).exists())
    folder.mkdir(parents=True)
    return folder.absolute()
