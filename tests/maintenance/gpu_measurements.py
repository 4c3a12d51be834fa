"""Measures two renderers beside one another: how long they take, and how far apart what they render is.

`maintenance.gpu` runs each command in a process of its own. What it finds is the last line of standard output, as JSON.
"""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import click
import torch
from torch import Tensor

from acquisition.recording.reader import Recording
from reconstruction.bench.rasterizer import random_cloud
from reconstruction.pipeline.artefacts import posed
from reconstruction.rendering.render import Backend, Rendering, render
from reconstruction.rendering.result import Instantaneous
from reconstruction.run.folder import RunFolder
from reconstruction.training.checkpoint import load_cloud
from rigs.camera import Camera
from rigs.toml import catalog_rig

RIG, VIEW = "lab3x3", "cam11"
COUNTS = (20_000, 48_000, 200_000)
REPEATS = 30
IMAGES = ("intensity", "depth", "alpha")


class Place(NamedTuple):
    """A renderer, and the device on which its tensors lie."""

    backend: Backend
    device: str


PLACES = (Place("gsplat", "cuda"), Place("native", "cpu"))


def _leaves(gaussians: Instantaneous, device: str) -> Instantaneous:
    return Instantaneous(*(t.detach().to(device).clone().requires_grad_() for t in gaussians))


def _now(device: str) -> float:
    """Return the time, in seconds, at which all that the device was given is done."""
    if device == "cuda":
        torch.cuda.synchronize()
    return time.perf_counter()


def times(counts: Sequence[int], places: Sequence[Place], camera: Camera, repeats: int = REPEATS) -> list[dict]:
    """Return the fastest of `repeats` passes forward and back, ms, by number of Gaussians and place."""
    rows = []
    for count in counts:
        cloud = random_cloud(count, camera)
        for place in places:
            leaves, passes = _leaves(cloud, place.device), []
            for _ in range(repeats + 1):
                began = _now(place.device)
                rendering = render(leaves, camera, backend=place.backend)
                loss = rendering.intensity.sum() + rendering.depth.sum()
                rendered = _now(place.device)
                loss.backward()
                passes.append((rendered - began, _now(place.device) - rendered))
            forward, backward = (1e3 * min(part) for part in zip(*passes[1:], strict=True))
            rows.append({**place._asdict(), "gaussians": count, "forward_ms": forward, "backward_ms": backward})
    return rows


def apart(gaussians: Instantaneous, camera: Camera, one: Place, other: Place) -> list[dict]:
    """Return how far `one` is from `other`: images, and the gradients of a loss that all of them have a part in.

    `max` and `mean` are absolute differences, in the unit of the image; of a gradient, as shares of its `largest`.
    """
    (images, slopes), (expected, steepness) = (_outcome(gaussians, camera, place) for place in (one, other))
    rows = [_gap(name, found, known, 1.0) for name, found, known in zip(IMAGES, images, expected, strict=True)]
    for name, found, known in zip(Instantaneous._fields, slopes, steepness, strict=True):
        rows.append(_gap(f"gradient of {name}", found, known, max(float(known.abs().max()), 1e-30)))
    return rows


def _outcome(gaussians: Instantaneous, camera: Camera, place: Place) -> tuple[list[Tensor], list[Tensor]]:
    leaves = _leaves(gaussians, place.device)
    rendering: Rendering = render(leaves, camera, backend=place.backend)
    images = [rendering.intensity[..., 0], rendering.depth, rendering.alpha]
    generator = torch.Generator().manual_seed(0)
    weights = torch.rand(len(images), *images[0].shape, generator=generator).to(place.device)
    (torch.stack(images) * weights).mean().backward()
    slopes = [torch.zeros_like(t) if t.grad is None else t.grad for t in leaves]
    return [t.detach().cpu() for t in images], [t.cpu() for t in slopes]


def _gap(name: str, found: Tensor, known: Tensor, unit: float) -> dict:
    off = (found - known).abs() / unit
    return {"of": name, "max": float(off.max()), "mean": float(off.mean()), "largest": float(known.abs().max())}


def compared(run_folder: Path, view: str, one: Place, other: Place) -> list[dict]:
    """Return `apart` of what a finished run has learnt, at the middle of its clip, as a camera sees it."""
    run = RunFolder.open(run_folder)
    recording, cloud = posed(run, Recording.open(run.recording), refined=True), load_cloud(run.checkpoint)
    with torch.no_grad():
        gaussians = cloud.at(cloud.clip.middle_s)  # type: ignore[attr-defined]
    return apart(gaussians, recording.rig.camera(view), one, other)


@click.group()
def main() -> None:
    """Measure gsplat on a CUDA device beside the native renderer."""


@main.command("kernels")
def kernels_command() -> None:
    """Render once, for which gsplat builds its kernels where it came without."""
    camera = catalog_rig(RIG).camera(VIEW).scaled(64, 40)
    click.echo(json.dumps(times((100,), PLACES[:1], camera, repeats=1)))


@main.command("times")
def times_command() -> None:
    """Time both renderers on random clouds."""
    click.echo(json.dumps(times(COUNTS, PLACES, catalog_rig(RIG).camera(VIEW))))


@main.command("apart")
@click.argument("run_folder", type=click.Path(path_type=Path))
def apart_command(run_folder: Path) -> None:
    """Compare what both renderers make of the finished run RUN_FOLDER."""
    click.echo(json.dumps(compared(run_folder, VIEW, *PLACES)))


if __name__ == "__main__":
    main()
