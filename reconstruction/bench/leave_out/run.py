"""Makes one run of the leave-out bench: its seconds and memory, its scores, and the claims of its plan."""

from __future__ import annotations

import re
import shutil
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np
import torch
from torch import Tensor

from acquisition.progress import silent
from acquisition.recording.reader import Recording
from acquisition.revision import code_revision
from reconstruction.bench.leave_out.cases import PLAN, Job
from reconstruction.bench.score_run import STAGES, held_out_with_truth
from reconstruction.errors import ReconstructionError
from reconstruction.evaluation.evaluate import score_against_truth
from reconstruction.gaussians import parts
from reconstruction.gaussians.dynamic import DynamicCloud
from reconstruction.initialization import texture
from reconstruction.pipeline.artefacts import MOVING, posed, read_views, read_white
from reconstruction.pipeline.stages import reconstruct
from reconstruction.rendering.result import Rendering
from reconstruction.run.folder import RunFolder
from reconstruction.scene_model import SceneModel
from reconstruction.training.checkpoint import load_checkpoint, load_cloud
from reconstruction.training.image_term import ImageTerm
from reconstruction.training.trainer import Trainer, TrainerSettings
from reconstruction.training.view import TrainingView

Result = TypeVar("Result")
SAMPLE_S = 0.01  # seconds between two looks at the memory


def measured(job: Job) -> dict:
    """Return seconds, processor seconds, peak memory in MB, scores and claims of a run; or `refused` and the reason.

    The memory is that of this whole process, so call it in a fresh one. Deletes the folder of the run.
    """
    try:
        found = _reconstructed(job) if job.arm.channels is None else _trained(job, job.arm.channels)
    except ReconstructionError as refusal:
        found = {"refused": str(refusal)}
    finally:
        shutil.rmtree(job.out, ignore_errors=True)
    return {"revision": code_revision(), **found}


def _reconstructed(job: Job) -> dict:
    shutil.rmtree(job.out, ignore_errors=True)
    run, row = _clocked(lambda: _run(job))
    row |= {f"seconds.{stage}": run.document.seconds[stage] for stage in STAGES}
    row |= {"steps": run.document.steps, "model": run.plan.model, "views": len(run.plan.views)}
    row |= {"decisions": {d.about: asdict(d) for d in run.plan.decisions}}
    return row | _scores(run, load_cloud(run.checkpoint))


def _clocked(work: Callable[[], Result]) -> tuple[Result, dict]:
    """Call `work`; return its result, and the seconds, processor seconds and peak memory in MB that it took."""
    with Memory() as memory:
        began, processed = time.monotonic(), time.process_time()
        result = work()
        took = {"seconds": time.monotonic() - began, "cpu_s": time.process_time() - processed}
    return result, took | {"peak_mb": memory.peak_mb}


def _run(job: Job) -> RunFolder:
    """Reconstruct up to the training; what has no option is put in beside the plan or after it."""
    config = job.arm.config(steps=job.steps, budget_s=job.budget_s)
    if job.arm.even:
        texture.PLAIN_SHARE = 1.0  # this process does nothing else
    if job.arm.whole:
        parts.RIDERS = sys.maxsize  # nor does it here
    made = partial(reconstruct, job.recording, job.out, config, lambda _: silent)
    run = made(last="plan")
    if job.arm.everywhere:
        for view in run.plan.views:
            name = MOVING.format(view=view)
            run.write_array(name, np.ones_like(run.read_array(name)))
    if job.arm.blind:
        for view in run.plan.views:
            name = MOVING.format(view=view)
            run.write_array(name, np.zeros_like(run.read_array(name)))
        still = run.plan.still_gaussians + run.plan.moving_gaussians
        run.document.planned = replace(run.plan, model="static", still_gaussians=still, moving_gaussians=0)
        run.save()
    return made(last="train")


def _scores(run: RunFolder, cloud: SceneModel) -> dict[str, float]:
    recording = posed(run, Recording.open(run.recording), refined=True)
    return score_against_truth(cloud, *held_out_with_truth(recording, run.plan.views))


def _trained(job: Job, channels: int) -> dict:
    """Measure the training alone, of Gaussians with so many channels, each compared with the grey target images."""
    run = _run(replace(job, arm=PLAN))
    recording = Recording.open(job.recording)
    cloud = DynamicCloud.from_state(load_checkpoint(run.snapshots()[0])["cloud"])
    for part in (cloud.still, cloud.moving):
        part.intensities = part.intensities.detach().repeat(1, channels)
    views = [TrainingView(camera, source) for camera, source in read_views(run, recording).values()]
    settings = TrainerSettings("pixels", white=read_white(run), tick_stride=run.config.tick_stride)
    trainer = Trainer(cloud, views, settings, recording.rig.clock, run.config.seed)
    assert isinstance(trainer.image, ImageTerm)
    trainer.image = EveryChannel(trainer.image)
    assert job.steps is not None
    shares = [step / job.steps for step in range(job.steps)]
    _, row = _clocked(lambda: [trainer.step(share) for share in shares])
    trainer.settle()
    learnt = trainer.cloud
    assert isinstance(learnt, DynamicCloud)
    for part in (learnt.still, learnt.moving):
        part.intensities = part.intensities.detach()[:, :1]
    return row | {"steps": trainer.steps} | _scores(run, learnt)


class EveryChannel(ImageTerm):
    """An image term whose loss is the mean over all channels of the render, each against the same grey image."""

    def __init__(self, grey: ImageTerm):
        super().__init__(**vars(grey))

    def held(self, view: TrainingView, rendered: Rendering, target: Tensor) -> Tensor:
        """Return the loss of one render against its target image [H, W]."""
        channels = (rendered._replace(intensity=channel[..., None]) for channel in rendered.intensity.unbind(-1))
        return torch.stack([super(EveryChannel, self).held(view, channel, target) for channel in channels]).mean()


class Memory:
    """Samples the most anonymous memory that this process holds while it is entered: `peak_mb`.

    Memory mapped from files, such as libraries, is left out: it comes and goes as others on the machine need memory.
    """

    def __enter__(self) -> Memory:
        self.peak_mb, self._ended = held_mb(), threading.Event()
        self._thread = threading.Thread(target=self._sample, daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()

    def _sample(self) -> None:
        while not self._ended.wait(SAMPLE_S):
            self.peak_mb = max(self.peak_mb, held_mb())


def held_mb() -> float:
    """Return the anonymous memory of this process in MB."""
    found = re.search(r"RssAnon:\s+(\d+) kB", Path("/proc/self/status").read_text())
    assert found is not None
    return int(found[1]) * 1024 / 1e6
