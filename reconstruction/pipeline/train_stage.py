"""Trains: budget, checkpoints, snapshots, and a clean stop on request."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import torch

from acquisition.progress import Progress
from acquisition.recording.reader import Recording
from reconstruction.images.catalogue import GIVEN
from reconstruction.images.composite import GivenSource
from reconstruction.initialization.bodies import Bodies
from reconstruction.initialization.points import Points, Seeds
from reconstruction.losses.picture import inverse_depth
from reconstruction.methods.catalogue import METHODS
from reconstruction.methods.definition import Method
from reconstruction.pipeline import artefacts
from reconstruction.pipeline.budget import Budget, StoppedError
from reconstruction.pipeline.given import given_source
from reconstruction.pipeline.preview import Preview
from reconstruction.pipeline.watch import Watch
from reconstruction.rendering import gsplat_backend
from reconstruction.rendering.render import Backend
from reconstruction.run.configuration import CUDA
from reconstruction.run.decisions import Decision, Plan
from reconstruction.run.document import EarlyEnd, Elements
from reconstruction.run.folder import RunFolder
from reconstruction.run.prices import Work
from reconstruction.scene_model import TimeSpan
from reconstruction.tensors import write_tensors
from reconstruction.training.checkpoint import load_checkpoint
from reconstruction.training.exposure import FROM
from reconstruction.training.lags import Lags
from reconstruction.training.regrouping import GAP_PX
from reconstruction.training.trainer import Trainer, TrainerSettings, train
from reconstruction.training.view import TrainingView

CHECKPOINT_EVERY_S = 5.0  # seconds between checkpoints
SNAPSHOT_AT = (1 / 64, 1 / 32, 1 / 16, 1 / 8, 1 / 4, 1 / 2, 3 / 4, 1.0)  # shares of the training, for the curve


def _beginning(run: RunFolder, recording: Recording) -> tuple[list[TrainingView], Seeds]:
    """Return the views of a training and the points to seed it; BadRunError where artefacts or truth are missing."""
    views = []
    for view, (camera, source) in artefacts.read_views(run, recording).items():
        known = inverse_depth(np.where(source.moving, np.nan, run.read_array(artefacts.DEPTH.format(view=view))))
        shown = given_source(view, source, recording, run.plan.images) if run.plan.images in GIVEN else source
        void = artefacts.read_empty(run, view)
        empty = None if void is None else torch.from_numpy(void)
        views.append(TrainingView(camera, shown, inverse_depth=known, empty=empty))
    still, moving = (artefacts.read(run, name, Points) for name in (artefacts.STILL, artefacts.MOVERS))
    clip, cameras = TimeSpan.of_planes(recording.rig.clock, 0, recording.planes), [view.camera for view in views]
    bodies = lambda: artefacts.read(run, artefacts.BODIES, Bodies)  # noqa: E731
    return views, Seeds(still, moving, clip, run.plan.sweeps, run.config.seed, cameras, bodies)


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
    preview = _shown(run, recording, trainer, budget, progress)

    def on_step(done: float, loss: float) -> None:
        watch.look(done, saver.checkpoint)
        saver.keep(done)
        preview.keep(trainer.result, trainer.steps)
        if trainer.steps % 10 == 0 or done >= 1:
            figures = (
                f"step {trainer.steps}, loss {loss:.4f}{trainer.closeness}, {len(trainer.cloud)} {trainer.cloud.unit}"
            )
            progress(done, f"{figures}{watch.note}")
        if should_stop() and done < 1:
            saver.checkpoint()
            raise StoppedError(f"stopped at step {trainer.steps}", do="the same command resumes it", where=run.path)

    if trainer.steps and trainer.done(budget.done(trainer.steps)) >= 1:  # killed after its last step
        saver.keep(1.0)
    else:
        train(trainer, lambda: trainer.done(budget.done(trainer.steps)), on_step)
    saver.checkpoint()
    preview.draw(trainer.result(), trainer.steps)
    if trainer.ending and budget.done(trainer.steps) < 1:
        reason = trainer.ending.reason(trainer.steps)
        run.document.stopped_early = EarlyEnd(trainer.steps, reason)
        progress(1.0, f"stopped early at step {trainer.steps}: {reason}")
    warn_if_missed(run, budget)
    _record(run, recording, trainer)


def warn_if_missed(run: RunFolder, budget: Budget) -> None:
    """Warn in the run where its seconds were over before its training began."""
    if budget.is_missed:
        began_s = budget.before_training_s
        run.document.warnings["train"] = (
            f"the budget of {budget.budget_s:g} s was over before training began, after {began_s:.1f} s: "
            f"this is the beginning, not a result; give it {3 * began_s:.0f} s or more"
        )


def _shown(run: RunFolder, recording: Recording, trainer: Trainer, budget: Budget, progress: Progress) -> Preview:
    """Draw how the training begins, say so, and return what goes on drawing."""
    preview = Preview(run, recording.rig, trainer.settings.white, budget.clock)
    preview.draw(trainer.cloud, trainer.steps)
    progress(trainer.done(budget.done(trainer.steps)), f"step {trainer.steps}, its first picture is drawn")
    return preview


def trainer_of(
    run: RunFolder, recording: Recording, backend: Backend | None = None, dtype: torch.dtype = torch.float32
) -> Trainer:
    """Return the trainer as a run starts it; float64 takes the reference as its backend.

    Without a backend it is that of the device that the run was asked to train on.
    """
    views, seeds = _beginning(run, recording)
    method = METHODS[run.plan.model]
    own, device = ("gsplat", gsplat_backend.DEVICE) if run.config.device == CUDA else ("native", "cpu")
    cloud = method.start(seeds)
    light = artefacts.read_light(run)
    if light.flickers:
        cloud.light = torch.from_numpy(light.gains)
    settings = replace(settings_of(run, method, views), backend=backend or own, device=device)
    if dtype != torch.float32:
        cloud = cloud.to(dtype)
    return Trainer(cloud, views, settings, recording.rig.clock, run.config.seed)


def settings_of(run: RunFolder, method: Method, views: Sequence[TrainingView]) -> TrainerSettings:
    """Return how the plan of a run trains a method on `views`, on the processor."""
    plan = run.plan
    white = artefacts.white_of([view.source.background for view in views])
    return TrainerSettings(
        plan.supervision,
        replace(method.training, rates=method.training.rates.times(run.config.rates)),
        white=max(white, 1e-6),
        tick_stride=run.config.tick_stride,
        image_planes=_image_planes(plan, views),
        refines=plan.refine,
        times=run.config.gains != "off" and plan.moving_gaussians > 0 and not method.rays and plan.images not in GIVEN,
        ends_early=method.training.ends_early and run.config.steps is None,
        doublings=plan.doublings,
        spike_weight=run.config.spike_weight,
    )


def _image_planes(plan: Plan, views: Sequence[TrainingView]) -> int:
    """Return the planes whose mean light an image is."""
    given = [view.source.planes for view in views if isinstance(view.source, GivenSource)]
    return given[0] if given else plan.window if plan.images == "interpolated" else 1


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
                "cloud": self.trainer.result().state(),
                "seconds": self.budget.elapsed_s(),
                "steps": self.trainer.steps,
            }
            write_tensors(self.run.path / "snapshots" / f"{self.trainer.steps:07d}.pt", state)
        if self.budget.clock() - self.last >= CHECKPOINT_EVERY_S:
            self.checkpoint()

    def checkpoint(self) -> None:
        """Write the state that a resumed training continues from."""
        state = {
            "cloud": self.trainer.result().state(),
            "trainer": self.trainer.state(),
            "watch": self.watch.state,
            "elapsed_s": self.budget.elapsed_s(),
            "before_training_s": self.budget.before_training_s,
        }
        write_tensors(self.run.checkpoint, state)
        self.last = self.budget.clock()


def _record(run: RunFolder, recording: Recording, trainer: Trainer) -> None:
    cloud = trainer.cloud
    if trainer.exposure and trainer.exposure.passed_px is not None and len(cloud.moving):
        passed_px, planes = trainer.exposure.passed_px, trainer.exposure.planes
        reason = f"fast movers get {passed_px:.1f} px far in the {planes} planes of an image"
        choice, saves_s = f"{trainer.exposure.nodes} instants an image from {FROM:.0%} on", None
        if trainer.exposure.nodes == 1:
            camera = trainer.views[0].camera
            size = (camera.width * camera.height, planes, len(trainer.views), len(cloud))
            choice, saves_s = "one instant an image", Work(*size, None, trainer.steps).second_instants_s(1 - FROM)
        facts = {"passed_px": passed_px, "planes": planes}
        run.amend("train", Decision("exposure", choice, reason, "none", saves_s, facts=facts))
    if trainer.joined and trainer.joined[0]:
        run.amend("train", _bodies(*trainer.joined))
    if trainer.lags and trainer.lags.looks:
        run.amend("train", _lags(trainer.lags, plan=run.plan))
    if trainer.refinement:
        artefacts.write_rig(run.path / artefacts.REFINED_RIG, trainer.refinement.refined(recording.rig))
        run.document.refinement = trainer.refinement.report()
    run.document.steps, run.document.backend = trainer.steps, trainer.settings.backend
    run.document.elements = Elements(cloud.unit.lower(), len(cloud.still), len(cloud.moving))


def _bodies(parts: int, bodies: int) -> Decision:
    """Return the decision on the bodies of a scene, which were made of so many parts."""
    reason = f"each of {parts} parts learnt a motion, and those of one body agree within {GAP_PX:g} px"
    return Decision("bodies", f"{bodies}", reason, "none", facts={"parts": parts, "bodies": bodies})


def _lags(lags: Lags, plan: Plan) -> Decision:
    """Return the decision on the lags of the views of `plan`, as the last look found them."""
    sd = float(np.sqrt(np.mean(lags.sds**2)))
    reason = f"movers are seen {lags.spread:.2f} ticks apart from camera to camera, known to {sd:.2f}"
    if not lags.ticks.any():
        return Decision("lags", "taken as alike", reason, "--gains")
    choice = f"each camera's own, {lags.ticks.min():+.2f} to {lags.ticks.max():+.2f} ticks"
    facts = {"sd": sd, **dict(zip(plan.views, lags.ticks.tolist(), strict=True))}
    return Decision("lags", choice, reason, "--gains", facts=facts)
