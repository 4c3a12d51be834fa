"""The train stage: budget, checkpoints, snapshots, and a clean stop on request."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields
from typing import Any

import numpy as np
import torch

from acquisition.progress import Progress
from acquisition.recording.reader import Recording
from reconstruction.errors import BadRunError
from reconstruction.evaluation.truth import Truth
from reconstruction.images.catalogue import GIVEN
from reconstruction.images.composite import CompositeSource, GivenSource
from reconstruction.images.flicker import Light
from reconstruction.images.methods.interpolated import PLANES
from reconstruction.methods.catalogue import METHODS
from reconstruction.methods.definition import Seeds
from reconstruction.pipeline.budget import Budget, StoppedError
from reconstruction.pipeline.poses import write_refined
from reconstruction.pipeline.stages import INSTANTS, composite_sources, moving_planes, read_bodies, read_points
from reconstruction.pipeline.watch import Watch
from reconstruction.rendering.render import Backend
from reconstruction.run.folder import RunFolder
from reconstruction.run.plan import Decision, Plan
from reconstruction.run.prices import Work
from reconstruction.scene_model import SceneModel, TimeSpan
from reconstruction.training.checkpoint import load_checkpoint, save_checkpoint
from reconstruction.training.choice import WINDOW, between, count_error
from reconstruction.training.depth_hold import ConfirmedDepth
from reconstruction.training.exposure import FROM, Exposure
from reconstruction.training.trainer import Trainer, TrainerSettings, train
from reconstruction.training.view import TrainingView
from rigs.rig import Rig

CHECKPOINT_EVERY_S = 5.0
SNAPSHOT_AT = (1 / 64, 1 / 32, 1 / 16, 1 / 8, 1 / 4, 1 / 2, 3 / 4, 1.0)  # shares of the training, for the curve


def train_stage(
    run: RunFolder, recording: Recording, progress: Progress, budget: Budget, should_stop: Callable[[], bool]
) -> None:
    """Train to the budget from the points, or on from the checkpoint; raises StoppedError when asked to stop."""
    trainer = trainer_of(run, recording)
    budget.before_training_s = budget.elapsed_s()
    watch = Watch(run, trainer)
    if run.checkpoint.exists():
        saved = load_checkpoint(run.checkpoint)
        trainer.restore(saved["trainer"])
        watch.resume(saved.get("watch"))
        budget.before_training_s = saved["before_training_s"]
        budget.spent_s = saved["elapsed_s"]
        budget.started = budget.clock()
    saver = _Saver(run, trainer, budget, watch)

    def on_step(done: float, loss: float) -> None:
        watch.look(done, saver.checkpoint)
        saver.keep(done)
        if trainer.steps % 10 == 0 or done >= 1:
            figures = (
                f"step {trainer.steps}, loss {loss:.4f}{trainer.closeness}, {len(trainer.cloud)} {trainer.cloud.unit}"
            )
            progress(done, f"{figures}{watch.note}")
        if should_stop() and done < 1:
            saver.checkpoint()
            raise StoppedError(f"stopped at step {trainer.steps}", do="the same command resumes it", where=run.path)

    train(trainer, lambda: trainer.done(budget.done(trainer.steps)), on_step)
    saver.checkpoint()
    if budget.done(trainer.steps) < 1:
        _say_ending(run, trainer, progress)
    if trainer.exposure and trainer.exposure.passed_px is not None and len(trainer.cloud.moving):
        _say_exposure(run, trainer, trainer.exposure)
    if trainer.refinement:
        write_refined(run, trainer.refinement.refined(recording.rig), trainer.refinement.report())
    run.document["steps"] = trainer.steps
    run.document[trainer.cloud.unit.lower()] = {"still": len(trainer.cloud.still), "moving": len(trainer.cloud.moving)}


def _say_ending(run: RunFolder, trainer: Trainer, progress: Progress) -> None:
    """Keep in `run.json` that the training ended before its budget, and why."""
    ending = trainer.ending
    assert ending is not None
    run.document["stopped_early"] = {"step": trainer.steps, "reason": ending.reason}
    progress(1.0, f"stopped early at step {trainer.steps}: {ending.reason}")


def _say_exposure(run: RunFolder, trainer: Trainer, exposure: Exposure) -> None:
    """Keep in the plan how many instants of an image were rendered, and why."""
    reason = f"fast movers get {exposure.passed_px:.1f} px far in the {exposure.planes} planes of an image"
    choice, saves_s = f"two instants an image from {FROM:.0%} on", None
    if exposure.nodes == 1:
        camera = trainer.views[0].camera
        size = (camera.width * camera.height, exposure.planes, len(trainer.views), len(trainer.cloud))
        choice, saves_s = "one instant an image", Work(*size, None, trainer.steps).second_instants_s(1 - FROM)
    plan = run.plan.amended(Decision("exposure", choice, reason, "none", saves_s))
    run.document["plan"] = plan.to_json()


class _Saver:
    """Writes the checkpoint every few seconds and a snapshot at each share of the training."""

    def __init__(self, run: RunFolder, trainer: Trainer, budget: Budget, watch: Watch):
        self.run, self.trainer, self.budget, self.watch = run, trainer, budget, watch
        self.last = budget.clock()
        done = trainer.done(budget.done(trainer.steps))
        self.due = [s for s in SNAPSHOT_AT if s > done or s == 1.0]  # the last state is always scored

    def keep(self, done: float) -> None:
        """Write what is due at this share of the training."""
        if self.due and done >= self.due[0]:
            while self.due and done >= self.due[0]:
                self.due.pop(0)
            state = {
                "cloud": self.trainer.cloud.state(),
                "seconds": self.budget.elapsed_s(),
                "steps": self.trainer.steps,
            }
            save_checkpoint(self.run.path / "snapshots" / f"{self.trainer.steps:07d}.pt", state)
        if self.budget.clock() - self.last >= CHECKPOINT_EVERY_S:
            self.checkpoint()

    def checkpoint(self) -> None:
        """Write the state a resumed training continues from."""
        state = {
            "cloud": self.trainer.cloud.state(),
            "trainer": self.trainer.state(),
            "watch": self.watch.state,
            "elapsed_s": self.budget.elapsed_s(),
            "before_training_s": self.budget.before_training_s,
        }
        save_checkpoint(self.run.checkpoint, state)
        self.last = self.budget.clock()


def trainer_of(
    run: RunFolder, recording: Recording, backend: Backend = "native", dtype: torch.dtype = torch.float32
) -> Trainer:
    """The trainer as a run starts it; float64 takes the reference as its backend."""
    rig, plan = recording.rig, run.plan
    clip = TimeSpan(0.0, recording.planes / rig.tick_rate_hz)
    sources = composite_sources(run, recording)
    if plan.images in GIVEN:
        sources = _given(sources, recording, plan.images)
    views = [TrainingView(rig.camera(v), source, depth=_confirmed(run, v, source)) for v, source in sources.items()]
    if run.config.model == "auto" and plan.model == "bases" and not run.checkpoint.exists():
        plan = _settled(run, clip, views, recording)
    cloud = _seeded(run, clip, rig)
    light = Light(run.read_array("plan/light"))
    if light.flickers:
        cloud.light = torch.from_numpy(light.gains)
    white = float(np.mean([np.percentile(source.background.image, 99.9) for source in sources.values()]))
    own: dict[str, Any] = {"ends_early": run.config.steps is None} | dict(METHODS[plan.model].trainer)
    settings = TrainerSettings(
        plan.supervision,
        white=max(white, 1e-6),
        tick_stride=run.config.tick_stride,
        refines=plan.refine,
        image_planes=PLANES if plan.images == "interpolated" else 1,
        backend=backend,
        **own,
    )
    if dtype != torch.float32:
        cloud = cloud.to(dtype)
    return Trainer(cloud, views, settings, rig.clock, run.config.seed)


def _confirmed(run: RunFolder, view: str, source: CompositeSource) -> ConfirmedDepth:
    """The depths that the points stage confirmed in a view's pixels that still count as still."""
    return ConfirmedDepth.of(run.read_array(f"points/depth_{view}")).without(source.moving)


def _given(sources: Mapping[str, CompositeSource], recording: Recording, images: str) -> dict[str, CompositeSource]:
    """The same sources with the clean or blurred truth of a simulated recording as their images."""
    if recording.truth is None:
        raise BadRunError("found no truth", f"a simulated recording for the images `{images}`", where=recording.path)
    truth = Truth.open(recording.truth)
    found: dict[str, CompositeSource] = {}
    for view, source in sources.items():
        frames = {
            plane: truth.blurred(view, plane) if images == "blurred" else truth.frame(view, plane).intensity
            for plane in truth.planes(view)
        }
        found[view] = GivenSource(*(getattr(source, f.name) for f in fields(CompositeSource)), frames=frames)
    return found


def _settled(run: RunFolder, clip: TimeSpan, views: list[TrainingView], recording: Recording) -> Plan:
    """The plan with the motion that better explains counts of the training cameras at instants nothing was swept at."""
    planes, clock = between(moving_planes(recording.planes, "bases")), recording.rig.clock
    errors = {}
    for model in ("bases", "linear"):
        run.document["plan"]["model"] = model
        cloud = _seeded(run, clip, recording.rig)
        errors[model] = count_error(cloud, views, planes, clock)
    model = min(errors, key=errors.__getitem__)
    reason = (
        f"between the swept instants {run.document['bodies']['rigid']} rigid bodies miss the counts of {WINDOW} "
        f"planes by {errors['bases']:.3f} spikes a moving pixel, points at rest by {errors['linear']:.3f}"
    )
    plan = run.plan.amended(Decision("motion", model, reason, "--model"), model=model)
    run.document["plan"] = plan.to_json()
    run.save()
    return plan


def _seeded(run: RunFolder, clip: TimeSpan, rig: Rig) -> SceneModel:
    still, moving = (read_points(run, kind) for kind in ("still", "moving"))
    cameras = [rig.camera(view) for view in run.plan.views]
    seeds = Seeds(still, moving, clip, INSTANTS, run.config.seed, cameras, lambda: read_bodies(run))
    return METHODS[run.plan.model].start(seeds)
