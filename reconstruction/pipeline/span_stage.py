"""The train stage of a recording in spans: what is due of the still scene and the spans, then one scene of them all."""

from collections.abc import Callable

import torch

from acquisition.progress import Progress
from acquisition.recording.reader import Recording
from reconstruction.errors import BadRunError
from reconstruction.gaussians.cloud import GaussianCloud
from reconstruction.gaussians.spanned import SpanContent, SpannedScene
from reconstruction.heap import share_heaps
from reconstruction.pipeline import artefacts
from reconstruction.pipeline.budget import Budget
from reconstruction.pipeline.parts_training import SpanTraining
from reconstruction.pipeline.preview import Preview
from reconstruction.pipeline.span_artefacts import parts_to_learn
from reconstruction.pipeline.train_stage import warn_if_missed
from reconstruction.run.decisions import Decision
from reconstruction.run.document import Elements
from reconstruction.run.folder import RunFolder
from reconstruction.run.parts import STILL, PartFolder
from reconstruction.scene_model import TimeSpan
from reconstruction.tensors import write_tensors

SNAPSHOT_AT = (0.0, 0.25, 0.5, 0.75)  # shares of the spans after which the curve has a point


def train_spans(
    run: RunFolder, recording: Recording, progress: Progress, budget: Budget, should_stop: Callable[[], bool]
) -> None:
    """Train all parts that are due and join them, without spans that were given up.

    Raises StoppedError when asked to stop, between two files, and PartError.
    """
    share_heaps()
    training = SpanTraining(run, recording, progress, budget, should_stop, parts_to_learn(run))
    budget.spent_s += sum(training.file(name).read()["seconds"] for name in sorted(training.folder.there()))
    still = training.still()
    spans, names = _at_rest(run, recording), [one.name for one in training.parts[1:]]
    scene = _scene(run, recording, still, spans)
    preview, given_up = _preview(run, recording, budget), training.folder.given_up()
    due, to_learn = list(SNAPSHOT_AT), [name for name in names if name not in given_up]
    _snap(training, scene, due, 0.0)
    for number, (name, content, is_new) in enumerate(training.spans(to_learn, still), start=1):
        spans[int(name)] = content
        if is_new or number == len(to_learn):
            preview.draw(scene.part(int(name)), training.steps)
        if number < len(to_learn):
            _snap(training, scene, due, number / len(to_learn))
    _snap(training, scene, [1.0], 1.0)
    state = {"cloud": scene.state(), "seconds": training.seconds, "elapsed_s": training.elapsed_s}
    write_tensors(run.checkpoint, state)
    run.document.warnings.pop("train", None)
    warn_if_missed(run, budget)
    _warn_of_missing(run, training.folder, sorted(name for name in names if name in given_up))
    _record(training, scene, [int(name) for name in names])


def learn_part(training: SpanTraining, name: str) -> bool:
    """Learn one part alone, whoever learns the others; return whether this process's result was kept.

    Raises BadRunError for a part that the run does not have, or one whose turn has not come, and StoppedError.
    """
    known = [STILL, *sorted(one.name for one in training.parts[1:])]
    if name not in known:
        names = ", ".join(known[:4]) + (" ..." if len(known) > 4 else "")
        raise BadRunError(f"found the part {name}", f"one that is learnt: {names}", where=training.run.path)
    if name != STILL and STILL not in training.folder.there():
        found = f"found no part {STILL}, which {name} begins with"
        raise BadRunError(found, do=f"run --part {STILL} first", where=training.run.path)
    training.folder.try_again(name)
    still = None if name == STILL else training.still()
    first = training.learn(name, training.progress, still)
    if first:
        run, recording = training.run, training.recording
        spans, shown = _at_rest(run, recording), len(run.plan.spans) // 2
        if still is not None:
            shown = int(name)
            spans[shown] = SpanContent.from_state(training.content(name))
        scene = _scene(run, recording, still or training.still(), spans)
        _preview(run, recording, training.budget).draw(scene.part(shown), training.steps)
    return first


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
