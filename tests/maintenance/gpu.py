"""Measures what a CUDA device makes of this code, part by part, beside the processor: `make gpu`.

It installs nothing: gsplat is the extra `gpu` (`make install EXTRAS=reconstruction,server,dev,gpu`), and builds its
kernels with nvcc when it first renders. Each part is a process with a time limit of its own. The document is written
after each, so that a cut-off call keeps what it had; the next goes on with the parts that failed or are missing.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from itertools import pairwise
from pathlib import Path
from typing import Any

import click
import torch
from maintenance.gpu_measurements import VIEW

from acquisition.bench_document import BenchDocument, device
from acquisition.durable import write_json
from acquisition.revision import code_revision
from reconstruction.errors import BadRunError
from reconstruction.rendering.gsplat_backend import why_unavailable

ROOT = Path(__file__).resolve().parents[2]
LIMIT_S = 1500.0  # seconds of all parts together
LEAST_S = 10.0  # seconds below which a part is not begun
SCORES = ("psnr_db", "dynamic_psnr_db", "ssim", "abs_rel")
MEASUREMENTS = "maintenance.gpu_measurements"
NETWORKS = "reconstruction.networks.train"
# gsplat's and torch's own warnings, which no one has seen yet, are no failures of a test.
TESTS = ("-q", "-m", "gpu", "-W", "default", "-p", "no:cacheprovider", "-n", "0")
RESOLVED: dict[str, Any] = {"path_type": Path, "resolve_path": True}  # parts run elsewhere
Found = list[dict[str, Any]]


@dataclass(frozen=True)
class Part:
    """A measurement: a command of Python, its time limit, and how its standard output is read.

    `leaves`: the folder that it makes anew, without which it was not done.
    """

    name: str
    limit_s: float
    arguments: Sequence[str]
    read: Callable[[str], Found]
    leaves: Path | None = None


def nothing(output: str) -> Found:
    """Return no rows: the part is there for others."""
    return []


def last_line(output: str) -> Found:
    """Return the JSON of the last line."""
    return json.loads(output.strip().splitlines()[-1])


def counts_of(output: str) -> Found:
    """Return the numbers of pytest's last line, such as `3 passed, 1 skipped in 4.20s`."""
    words = output.strip().splitlines()[-1].replace(",", "").split()
    return [{word: int(number) for number, word in pairwise(words) if number.isdigit()}]


def trained(run: Path, chosen: str, length: str, output: str) -> Found:
    """Return scores and seconds of a finished run."""
    document, metrics = (json.loads((run / name).read_text()) for name in ("run.json", "metrics.json"))
    scores = {name: metrics[name] for name in SCORES if name in metrics}
    known = {"device": chosen, "backend": document["backend"], "recording": Path(document["recording"]).name}
    return [{**known, "length": length, "steps": document["steps"], "train_s": document["seconds"]["train"], **scores}]


def learnt(folder: Path, output: str) -> Found:
    """Return the last score of a training of a network."""
    document = json.loads((folder / "training.json").read_text())
    return [{"network": document["network"], **document["curve"][-1]}]


def parts_of(work: Path, recording: Path | None, steps: int, budget_s: float, network_steps: int) -> list[Part]:
    """Return the parts in their order, those that tell most first; folders lie in `work`."""
    source, cli = recording or work / "rec", ("-m", "server.cli")
    simulate = (*cli, "simulate", "--scene", "fan_and_ball", "--seed", "1", "--out", str(source))
    parts = [
        Part("kernels", 480, ("-m", MEASUREMENTS, "kernels"), last_line),
        Part("tests", 240, ("-m", "pytest", *TESTS), counts_of),
        Part("times", 180, ("-m", MEASUREMENTS, "times"), last_line),
        *([] if recording else [Part("recording", 180, simulate, nothing, source)]),
    ]
    lengths = ((f"{steps} steps", "--steps", f"{steps}"), (f"{budget_s:g} s", "--budget-s", f"{budget_s:g}"))
    for length, option, number in lengths:
        for chosen in ("cuda", "cpu"):
            run = work / f"{chosen}{option[1:]}-{number}"
            choices = ("--device", chosen, "--holdout", VIEW, option, number)
            arguments = (*cli, "reconstruct", str(source), "--out", str(run), *choices)
            read = partial(trained, run, chosen, length)
            parts.append(Part(f"training {chosen} {length}", 240, arguments, read, run))
    parts.append(Part("apart", 90, ("-m", MEASUREMENTS, "apart", str(work / f"cpu-steps-{steps}")), last_line))
    if network_steps:
        clips, out = work / "clips", work / "network"
        make = ("-m", NETWORKS, "clips", "--count", "60", "--out", str(clips))
        learn = ("-m", NETWORKS, "network", "small", "--device", "cuda", "--batch", "16", "--clips", str(clips))
        length_of = ("--steps", f"{network_steps}", "--score-every", f"{network_steps}", "--out", str(out))
        parts.append(Part("clips", 180, make, nothing, clips))
        parts.append(Part("network", 300, (*learn, *length_of), partial(learnt, out), out))
    return parts


def machine() -> dict[str, Any]:
    """Return what the figures depend on: device, driver and versions. Raises BadRunError without a device."""
    missing = why_unavailable()
    if missing:
        found, do = f"found no GPU to measure ({missing})", "call it on a machine that has both"
        raise BadRunError(found, "gsplat and a CUDA device", do)
    ask = ["nvidia-smi", "--query-gpu=driver_version", "--format=csv,noheader"]
    try:
        driver = subprocess.run(ask, capture_output=True, text=True, timeout=30, check=True).stdout.splitlines()[0]
    except (OSError, subprocess.SubprocessError, IndexError):
        driver = None
    known = {"accelerator": torch.cuda.get_device_name(0), "driver": driver, "torch": torch.__version__}
    return known | {"cuda": torch.version.cuda, "gsplat": version("gsplat")}


class Measured:
    """The parts that were done on a machine, in the document `out`, which is written after each."""

    def __init__(self, out: Path, known: Mapping[str, Any]) -> None:
        self._out, self._known, self._revision = out, dict(known), code_revision()
        found = json.loads(out.read_text()) if out.exists() else {"rows": [], "device": {}}
        same = all(found["device"].get(name) == value for name, value in known.items())
        self.rows = [r for r in found["rows"] if same and _code(r["revision"]) == _code(self._revision)]
        self.left: list[str] = []

    def missing(self, parts: Sequence[Part]) -> list[Part]:
        """Return the parts that are not done, or whose folder is gone."""
        done = {row["part"] for row in self.rows if "error" not in row}
        return [p for p in parts if p.name not in done or (p.leaves is not None and not p.leaves.exists())]

    def run(self, part: Part, limit_s: float) -> None:
        """Run a part within `limit_s` seconds and write what it found, or why it failed in one line."""
        if part.leaves is not None:
            shutil.rmtree(part.leaves, ignore_errors=True)
        began = time.monotonic()
        try:
            outcome: dict[str, Any] = {"found": part.read(output_of(part.arguments, min(part.limit_s, limit_s)))}
        except (BadRunError, OSError, ValueError, LookupError) as error:
            outcome = {"error": (str(error).strip().splitlines() or [type(error).__name__])[-1][:300]}
        row = {"part": part.name, "seconds": round(time.monotonic() - began, 2), "revision": self._revision, **outcome}
        self.rows = [r for r in self.rows if r["part"] != part.name] + [row]
        self.write()
        click.echo(f"{part.name}: {row['seconds']:.0f} s, {outcome.get('error', 'done')}")

    def write(self) -> None:
        """Write the document aside and put it in place."""
        document = self.document().to_json() | {"device": {**device(), **self._known}}
        write_json(self._out, document | {"revision": self.rows[0]["revision"] if self.rows else self._revision})

    def document(self) -> BenchDocument:
        """Return all parts, and their figures by name."""
        omissions = [f"{row['part']}: {row['error']}" for row in self.rows if "error" in row]
        summary = {key: value for row in self.rows for key, value in figures(row).items()}
        return BenchDocument("gpu", self.rows, [*omissions, *self.left], summary)


def figures(row: Mapping[str, Any]) -> dict[str, float]:
    """Return the named figures of a part."""
    named: dict[str, float] = {f"seconds.{row['part'].replace(' ', '_')}": row["seconds"]}
    for found in row.get("found", ()):
        if "forward_ms" in found and row["part"] != "kernels":
            at = f"@{found['gaussians'] // 1000}k"
            named |= {f"{found['backend']}.{name}{at}": found[name] for name in ("forward_ms", "backward_ms")}
        elif "length" in found:
            at = f"@{found['length'].replace(' ', '_')}"
            named |= {f"{found['device']}.{n}{at}": found[n] for n in (*SCORES, "train_s", "steps") if n in found}
        elif "of" in found:
            named |= {f"{found['of'].replace(' ', '_')}.{name}": found[name] for name in ("max", "mean")}
        elif row["part"] in ("tests", "network"):
            named |= {f"{row['part']}.{n}": v for n, v in found.items() if isinstance(v, int | float)}
    return named


def output_of(arguments: Sequence[str], limit_s: float) -> str:
    """Return what Python prints for `arguments`; raises BadRunError with the last line where it fails or takes longer.

    All that the command started ends with it.
    """
    environment = os.environ | {"PYTHONPATH": str(ROOT / "tests")}
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    process = subprocess.Popen([sys.executable, *arguments], cwd=ROOT, env=environment, start_new_session=True, **pipes)
    try:
        output, errors = process.communicate(timeout=limit_s)
    except subprocess.TimeoutExpired:
        raise BadRunError(f"took more than {limit_s:.0f} s") from None
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
    if process.returncode:
        lines = [line for text in (output, errors) for line in text.splitlines() if line.strip()]
        raise BadRunError(lines[-1].strip() if lines else f"exit code {process.returncode}")
    return output


def _code(revision: str) -> str:
    """Return a revision without the mark of a changed tree, which writing the document may leave."""
    return revision.removesuffix("-dirty")


def measure(measured: Measured, parts: Sequence[Part], limit_s: float) -> None:
    """Run what is missing, until `limit_s` seconds are over; what is left then is among the omissions."""
    until = time.monotonic() + limit_s
    for part in measured.missing(parts):
        left_s = until - time.monotonic()
        if left_s < LEAST_S:
            measured.left.append(f"{part.name}: not begun, {limit_s:.0f} s were over")
        else:
            measured.run(part, left_s)
    measured.write()


@click.command()
@click.option("--recording", type=click.Path(exists=True, **RESOLVED), help="Train on it in place of a simulated one.")
@click.option("--steps", type=click.IntRange(1), default=2000, show_default=True, help="Of trainings of equal steps.")
@click.option("--budget-s", type=float, default=60.0, show_default=True, help="Of trainings of equal time.")
@click.option("--network-steps", type=click.IntRange(0), default=0, show_default=True, help="Also train a network.")
@click.option("--limit-s", type=float, default=LIMIT_S, show_default=True, help="Of all parts together.")
@click.option("--work", type=click.Path(**RESOLVED), default=ROOT / "runs" / "gpu", show_default=True)
@click.option("--out", type=click.Path(dir_okay=False, **RESOLVED), required=True)
def main(
    recording: Path | None, steps: int, budget_s: float, network_steps: int, limit_s: float, work: Path, out: Path
) -> None:
    """Run the parts that OUT lacks, and write each as it ends. Exit 1 where one failed, 2 without a device."""
    try:
        measured = Measured(out, machine())
    except BadRunError as error:
        click.echo(f"Error: {error}", err=True)
        raise SystemExit(error.exit_code) from None
    # Kernels that are built on first use, for this device alone: a few minutes in place of many.
    os.environ.setdefault("TORCH_CUDA_ARCH_LIST", ".".join(map(str, torch.cuda.get_device_capability(0))))
    work.mkdir(parents=True, exist_ok=True)
    measure(measured, parts_of(work, recording, steps, budget_s, network_steps), limit_s)
    for name, value in measured.document().summary.items():
        click.echo(f"{name:40} {value:g}")
    raise SystemExit(1 if measured.document().omissions else 0)


if __name__ == "__main__":
    main()
