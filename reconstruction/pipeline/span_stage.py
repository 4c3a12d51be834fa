"""The train stage of a recording in spans: what is due of the still scene and the spans, then one scene of them all.

A file is written when its part is learnt, so that a run that was stopped or killed goes on with the next one.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch

from acquisition.progress import Progress, part
from acquisition.recording.reader import Recording
from reconstruction.gaussians.cloud import GaussianCloud
from reconstruction.gaussians.spanned import SpanContent, SpannedScene
from reconstruction.pipeline import artefacts
from reconstruction.pipeline.budget import Budget, StoppedError
from reconstruction.pipeline.preview import Preview
from reconstruction.pipeline.span_artefacts import moving_spans, span_file, still_file
from reconstruction.pipeline.span_training import learn_span, learn_still
from reconstruction.pipeline.train_stage import warn_if_missed
from reconstruction.run.decisions import Decision
from reconstruction.run.document import Elements
from reconstruction.run.folder import SPANS, RunFolder
from reconstruction.scene_model import TimeSpan
from reconstruction.tensors import read_tensors, write_tensors
from reconstruction.training.trainer import Trainer

STILL = 1.5  # trainings of a span that the training of the still scene is worth
SNAPSHOT_AT = (0.0, 0.25, 0.5, 0.75)  # shares of the spans after which the curve has a point


@dataclass
class _Part:
    """One training of the stage: its name, and the share of the stage that is done before it and after it."""

    name: str
    begins: float
    ends: float


@dataclass
class SpanTraining:
    """The training of one run: `seconds` by part that is done, and `steps` of all of them."""

    run: RunFolder
    recording: Recording
    progress: Progress
    budget: Budget
    should_stop: Callable[[], bool]
    steps: int = 0
    seconds: dict[str, float] = field(default_factory=dict)

    def still(self, ends: float) -> GaussianCloud:
        """Return the still scene, learnt now if it was not before; `ends`: the share of the stage that it is."""

        def learn(now: _Part) -> dict[str, Any]:
            return vars(learn_still(self.run, self.recording, self._done(now), self._on_step(now)))

        return GaussianCloud(**self._kept("still", still_file(self.run), learn, (0.0, ends)))

    def span(self, number: int, still: GaussianCloud, ends: tuple[float, float]) -> SpanContent:
        """Return what the span `number` has of its own, learnt now if it was not before."""

        def learn(now: _Part) -> dict[str, Any]:
            task = (self.run, self.recording, number, still)
            return learn_span(*task, self._done(now), self._on_step(now)).state()

        return SpanContent.from_state(self._kept(f"span {number}", span_file(self.run, number), learn, ends))

    def _kept(self, name: str, file: Path, learn: Callable[[_Part], dict[str, Any]], ends: tuple[float, float]) -> dict:
        """Return what `learn` makes, kept in `file`; what an earlier process has kept is not learnt again."""
        if not file.exists():
            began, before = self.budget.elapsed_s(), self.steps
            learnt = learn(_Part(name, *ends))
            took = {"seconds": self.budget.elapsed_s() - began, "steps": self.steps - before}
            write_tensors(file, {"content": learnt, **took})
            self.steps = before
        kept = _read(file)
        self.steps += kept["steps"]
        self.seconds[name] = kept["seconds"]
        return kept["content"]

    def _done(self, now: _Part) -> Callable[[int], float]:
        """Return the share of a part that is done after so many steps of it, by the budget that it has."""
        if self.budget.steps is not None:
            return self.budget.done
        began, room_s = self.budget.elapsed_s(), (self.budget.budget_s or 0.0) - self.budget.elapsed_s()
        own_s = room_s * (now.ends - now.begins) / (1 - now.begins)
        return lambda _: 1.0 if own_s <= 0 else min(1.0, (self.budget.elapsed_s() - began) / own_s)

    def _on_step(self, now: _Part) -> Callable[[Trainer, float, float], None]:
        own, before = part(self.progress, now.begins, now.ends), self.steps

        def on_step(trainer: Trainer, share: float, loss: float) -> None:
            self.steps = before + trainer.steps
            if trainer.steps % 10 == 0 or share >= 1:
                own(share, f"{now.name}: step {trainer.steps}, loss {loss:.4f}{trainer.closeness}")
            if self.should_stop() and share < 1:
                do, done = "the same command resumes it", f"stopped in {now.name} at step {trainer.steps}"
                raise StoppedError(done, do=do, where=self.run.path)

        return on_step


def train_spans(
    run: RunFolder, recording: Recording, progress: Progress, budget: Budget, should_stop: Callable[[], bool]
) -> None:
    """Train all parts that are due and join them; raises StoppedError when asked to stop, between two files."""
    training = SpanTraining(run, recording, progress, budget, should_stop)
    budget.before_training_s = budget.elapsed_s()
    budget.spent_s += sum(kept["seconds"] for kept in map(_read, sorted((run.path / SPANS).glob("*.pt"))))
    moving, planes = moving_spans(run), run.plan.spans
    ends = [(STILL + i) / (STILL + len(moving)) for i in range(len(moving) + 1)]
    spans = [SpanContent.as_usual(TimeSpan.of_planes(recording.rig.clock, span.first, span.last)) for span in planes]
    still = training.still(ends[0])
    light, clip = artefacts.read_light(run), TimeSpan.of_planes(recording.rig.clock, 0, recording.planes)
    gains = torch.from_numpy(light.gains) if light.flickers else torch.ones(1)
    scene = SpannedScene(still, spans, clip, gains)
    preview = Preview(run, recording.rig, max(artefacts.read_white(run), 1e-6), budget.clock)
    due = list(SNAPSHOT_AT)
    for i, number in enumerate(moving):
        _snap(training, scene, due, i / len(moving))
        spans[number] = training.span(number, still, (ends[i], ends[i + 1]))
        preview.draw(scene.part(number), training.steps)
    _snap(training, scene, [1.0], 1.0)
    state = {"cloud": scene.state(), "seconds": training.seconds, "elapsed_s": budget.elapsed_s()}
    write_tensors(run.checkpoint, state)
    warn_if_missed(run, budget)
    _record(training, scene, len(moving))


def _read(file: Path) -> dict[str, Any]:
    return read_tensors(file, "a part of a training", "run the train stage again")


def _snap(training: SpanTraining, scene: SpannedScene, due: list[float], done: float) -> None:
    """Keep the scene as far as it is learnt, where the curve wants a point at this share of the spans."""
    if due and done >= due[0]:
        due.pop(0)
        state = {"cloud": scene.state(), "seconds": training.budget.elapsed_s(), "steps": training.steps}
        write_tensors(training.run.path / "snapshots" / f"{training.steps:07d}.pt", state)


def _record(training: SpanTraining, scene: SpannedScene, moving: int) -> None:
    """Write into the run what it has learnt, and what spans without movers have saved."""
    run, took = training.run, [s for name, s in training.seconds.items() if name != "still"]
    resting = len(scene.spans) - moving
    if resting:
        usual_s = sum(took) / len(took) if took else 0.0
        reason = f"{resting} of {len(scene.spans)} spans show nothing but the still scene, or nothing at all"
        choice = f"{resting} spans are not learnt"
        run.amend("train", Decision("spans at rest", choice, reason, "none", resting * usual_s))
    run.document.steps = training.steps
    run.document.elements = Elements(scene.unit.lower(), len(scene.still), len(scene.moving))
