"""The kinds of work: queues, workflows, their stages, and the command line of each stage."""

from __future__ import annotations

from pathlib import Path

from server.schemas import CaptureRequest, JobRequest
from server.settings import RigSource

APPLICATION = "spike4dgs"
# Workflows replay their steps by position: change this when, and only when, the order of stages changes.
APPLICATION_VERSION = "2"

CAPTURE, CAPTURE_QUEUE = "capture", "captures"
RECONSTRUCT, RECONSTRUCT_QUEUE = "reconstruct", "reconstructions"

CAPTURE_STAGES = ("record",)
RECONSTRUCTION_STAGES = ("plan", "poses", "images", "points", "train", "report")

ARTEFACTS = {
    "run.json": "application/json",
    "metrics.json": "application/json",
    "error_vs_time.json": "application/json",
    "error_vs_time.png": "image/png",
    "report.html": "text/html",
    "orbit.mp4": "video/mp4",
}


def record_arguments(request: CaptureRequest, rig: RigSource, recording: Path) -> list[str]:
    """Arguments of `spike4dgs` that make a recording."""
    return [
        "record",
        "--rig",
        rig.rig,
        "--devices",
        rig.devices,
        "--ticks",
        str(request.ticks),
        "--out",
        str(recording),
    ]


def reconstruct_arguments(request: JobRequest, stage: str, recording: Path, run: Path) -> list[str]:
    """Arguments of `spike4dgs` that run one stage of a reconstruction."""
    options = request.model_dump(exclude={"capture"}, exclude_none=True)
    flags = [text for name, value in options.items() for text in (f"--{name.replace('_', '-')}", str(value))]
    return ["reconstruct", str(recording), "--out", str(run), "--stage", stage, *flags]
