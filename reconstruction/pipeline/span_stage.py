"""The train stage of a recording in spans: what is due of the still scene and the spans, then one scene of them all.

Each part has a share of the training's seconds that is its own, whichever process learns it, and leaves a file. So a
run that was stopped or killed goes on with the next part, and several processes can share the parts.
"""

import gc
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import torch

from acquisition.progress import Progress, part
from acquisition.recording.reader import Recording
from reconstruction.errors import BadRunError
from reconstruction.gaussians.cloud import GaussianCloud
from reconstruction.gaussians.spanned import SpanContent, SpannedScene
from reconstruction.pipeline import artefacts
from reconstruction.pipeline.budget import Budget, StoppedError
from reconstruction.pipeline.part_file import Beat, PartFile
from reconstruction.pipeline.preview import Preview
from reconstruction.pipeline.span_artefacts import parts_to_learn
from reconstruction.pipeline.span_training import learn_span, learn_still
from reconstruction.pipeline.train_stage import warn_if_missed
from reconstruction.run.configuration import STAGES
from reconstruction.run.decisions import Decision
from reconstruction.run.document import Elements
from reconstruction.run.folder import RunFolder
from reconstruction.run.parts import STILL, Part, PartFolder, shares_of
from reconstruction.scene_model import TimeSpan
from reconstruction.tensors import write_tensors
from reconstruction.training.trainer import Trainer

SNAPSHOT_AT = (0.0, 0.25, 0.5, 0.75)  # shares of the spans after which the curve has a point
_WHOLE = (0.0, 1.0)


class PartError(BadRunError):
    """A part of a training that was given up, without which there is nothing to show."""

    exit_code = 1

    def __init__(self, found: str, *, bad_input: bool) -> None:
        super().__init__(found, do="run the stage again, or its part")
        self.bad_input = bad_input


@dataclass
class SpanTraining:
    """The training of one run: `seconds` by part that is read, and `steps` of all of them.

    `parts` are all of them, noted or not given, in an order in which they can be learnt one after the other.
    """

    run: RunFolder
    recording: Recording
    progress: Progress
    budget: Budget
    should_stop: Callable[[], bool]
    parts: list[Part] = field(default_factory=list)
    steps: int = 0
    seconds: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.parts = self.parts or PartFolder(self.run.path).noted() or parts_to_learn(self.run)
        done = self.run.document.seconds
        self.before_s = sum(done[name] for name in STAGES[: STAGES.index("train")] if name in done)
        self.budget.before_training_s = self.before_s
        self.folder, self.shares = PartFolder(self.run.path), shares_of(self.parts)

    @property
    def elapsed_s(self) -> float:
        """The seconds of the run until the last part that was read was learnt, by one process after the other."""
        return self.before_s + sum(self.seconds.values())

    def file(self, name: str) -> PartFile:
        """Return the file of a part."""
        return PartFile(self.folder, name, self._pause)

    def still(self) -> GaussianCloud:
        """Return the still scene, learnt now if it was not before; raises PartError where it was given up."""
        failure = self.folder.failure(STILL)
        if failure is not None and not self.file(STILL).is_there:
            found = f"found the still scene given up after {failure.tries} tries: {failure.reason}"
            raise PartError(found, bad_input=failure.bad_input)
        self.learn(STILL, self.shares[STILL])
        return GaussianCloud(**self.content(STILL))

    def span(self, name: str, still: GaussianCloud) -> SpanContent:
        """Return what a span has of its own, learnt now if it was not before."""
        self.learn(name, self.shares[name], still)
        return SpanContent.from_state(self.content(name))

    def learn(self, name: str, within: tuple[float, float], still: GaussianCloud | None = None) -> bool:
        """Learn a part unless it is there; return whether this process's result was kept, and no earlier one.

        `within` is the share of the progress that it is; a span is learnt beside the `still` scene.
        """

        def learnt(beat: Beat) -> dict[str, Any]:
            began, counted = self.budget.elapsed_s(), _Steps()
            task = (self.done_of(name), self._on_step(name, within, counted, beat))
            if still is None:
                content = vars(learn_still(self.run, self.recording, *task))
            else:
                content = learn_span(self.run, self.recording, int(name), still, *task).state()
            return {"content": content, "seconds": self.budget.elapsed_s() - began, "steps": counted.steps}

        kept = self.file(name).keep(learnt)
        gc.collect()  # closures hold one another, and with them the images of a span and its planes
        return kept

    def content(self, name: str) -> dict[str, Any]:
        """Return what was learnt of a part, and count its seconds and steps."""
        kept = self.file(name).read()
        self.steps += kept["steps"]
        self.seconds[_label(name)] = kept["seconds"]
        return kept["content"]

    def done_of(self, name: str) -> Callable[[int], float]:
        """Return the share of a part that is done after so many steps of it, by the seconds that are its own."""
        if self.budget.steps is not None:
            return self.budget.done
        first, last = self.shares[name]
        began, own_s = self.budget.elapsed_s(), ((self.budget.budget_s or 0.0) - self.before_s) * (last - first)
        return lambda _: 1.0 if own_s <= 0 else min(1.0, (self.budget.elapsed_s() - began) / own_s)

    def _on_step(
        self, name: str, within: tuple[float, float], counted: "_Steps", beat: Beat
    ) -> Callable[[Trainer, float, float], None]:
        own, label = part(self.progress, *within), _label(name)

        def on_step(trainer: Trainer, share: float, loss: float) -> None:
            counted.steps = trainer.steps
            if trainer.steps % 10 == 0 or share >= 1:
                beat()
                own(share, f"{label}: step {trainer.steps}, loss {loss:.4f}{trainer.closeness}")
            if share < 1:
                self._expect_more(f"stopped in {label} at step {trainer.steps}")

        return on_step

    def _pause(self, seconds: float) -> None:
        self._expect_more("stopped while another process learnt a part")
        time.sleep(seconds)

    def _expect_more(self, found: str) -> None:
        if self.should_stop():
            raise StoppedError(found, do="the same command resumes it", where=self.run.path)


@dataclass
class _Steps:
    """The steps of one part so far."""

    steps: int = 0


def train_spans(
    run: RunFolder, recording: Recording, progress: Progress, budget: Budget, should_stop: Callable[[], bool]
) -> None:
    """Train all parts that are due and join them, without spans that were given up.

    Raises StoppedError when asked to stop, between two files, and PartError.
    """
    training = SpanTraining(run, recording, progress, budget, should_stop, parts_to_learn(run))
    budget.spent_s += sum(training.file(name).read()["seconds"] for name in sorted(training.folder.there()))
    still = training.still()
    spans, names = _at_rest(run, recording), [one.name for one in training.parts[1:]]
    scene = _scene(run, recording, still, spans)
    preview, given_up = _preview(run, recording, budget), training.folder.given_up()
    due = list(SNAPSHOT_AT)
    for i, name in enumerate(names):
        _snap(training, scene, due, i / len(names))
        if name not in given_up:
            is_new = not training.file(name).is_there
            spans[int(name)] = training.span(name, still)
            if is_new or i == len(names) - 1:
                preview.draw(scene.part(int(name)), training.steps)
    _snap(training, scene, [1.0], 1.0)
    state = {"cloud": scene.state(), "seconds": training.seconds, "elapsed_s": training.elapsed_s}
    write_tensors(run.checkpoint, state)
    run.document.warnings.pop("train", None)
    warn_if_missed(run, budget)
    _warn_of_missing(run, training.folder, [name for name in names if name in given_up])
    _record(training, scene, [int(name) for name in names])


def learn_part(training: SpanTraining, name: str) -> bool:
    """Learn one part alone, whoever learns the others; return whether this process's result was kept.

    Raises BadRunError for a part that the run does not have, or one whose turn has not come, and StoppedError.
    """
    known = [one.name for one in training.parts]
    if name not in known:
        names = ", ".join(known[:4]) + (" ..." if len(known) > 4 else "")
        raise BadRunError(f"found the part {name}", f"one that is learnt: {names}", where=training.run.path)
    if name != STILL and STILL not in training.folder.there():
        found = f"found no part {STILL}, which {name} begins with"
        raise BadRunError(found, do=f"run --part {STILL} first", where=training.run.path)
    training.folder.try_again(name)
    still = None if name == STILL else training.still()
    first = training.learn(name, _WHOLE, still)
    if first:
        run, recording = training.run, training.recording
        spans, shown = _at_rest(run, recording), len(run.plan.spans) // 2
        if still is not None:
            shown = int(name)
            spans[shown] = SpanContent.from_state(training.content(name))
        scene = _scene(run, recording, still or training.still(), spans)
        _preview(run, recording, training.budget).draw(scene.part(shown), training.steps)
    return first


def _label(name: str) -> str:
    return name if name == STILL else f"span {int(name)}"


def _at_rest(run: RunFolder, recording: Recording) -> list[SpanContent]:
    """Return the content of all spans as if they showed the still scene alone."""
    clock = recording.rig.clock
    return [SpanContent.as_usual(TimeSpan.of_planes(clock, span.first, span.last)) for span in run.plan.spans]


def _scene(run: RunFolder, recording: Recording, still: GaussianCloud, spans: list[SpanContent]) -> SpannedScene:
    light, clip = artefacts.read_light(run), TimeSpan.of_planes(recording.rig.clock, 0, recording.planes)
    gains = torch.from_numpy(light.gains) if light.flickers else torch.ones(1)
    return SpannedScene(still, spans, clip, gains)


def _preview(run: RunFolder, recording: Recording, budget: Budget) -> Preview:
    return Preview(run, recording.rig, max(artefacts.read_white(run), 1e-6), budget.clock)


def _snap(training: SpanTraining, scene: SpannedScene, due: list[float], done: float) -> None:
    """Keep the scene as far as it is learnt, where the curve wants a point at this share of the spans."""
    if due and done >= due[0]:
        due.pop(0)
        state = {"cloud": scene.state(), "seconds": training.elapsed_s, "steps": training.steps}
        write_tensors(training.run.path / "snapshots" / f"{training.steps:07d}.pt", state)


def _warn_of_missing(run: RunFolder, folder: PartFolder, names: list[str]) -> None:
    """Warn in the run of spans that were given up: they show nothing that moves."""
    if not names:
        return
    failure, numbers = folder.failure(names[0]), ", ".join(str(int(name)) for name in names[:10])
    said = f"spans {numbers}{' ...' if len(names) > 10 else ''} were given up and show the still scene alone"
    reason = "" if failure is None else f"; the first after {failure.tries} tries: {failure.reason}"
    earlier = run.document.warnings.get("train")
    run.document.warnings["train"] = "; ".join(filter(None, (earlier, said + reason)))


def _record(training: SpanTraining, scene: SpannedScene, moving: list[int]) -> None:
    """Write into the run what it has learnt, and what spans without movers, by their length, have saved."""
    run, spans = training.run, training.run.plan.spans
    resting = [span for number, span in enumerate(spans) if number not in moving]
    if resting:
        learnt_s = sum(seconds for name, seconds in training.seconds.items() if name != STILL)
        saved_s = learnt_s * sum(map(len, resting)) / max(1, sum(len(spans[number]) for number in moving))
        reason = f"{len(resting)} of {len(spans)} spans show nothing but the still scene, or nothing at all"
        choice = f"{len(resting)} spans are not learnt"
        run.amend("train", Decision("spans at rest", choice, reason, "none", saved_s))
    run.document.steps = training.steps
    run.document.elements = Elements(scene.unit.lower(), len(scene.still), len(scene.moving))
