"""`reconstruct`: the stages in order, each timed, each skipped where its artefacts are already there."""

import time
from collections.abc import Callable
from pathlib import Path

from acquisition.progress import Progress
from acquisition.recording.growing import open_growing
from acquisition.recording.reader import Recording
from acquisition.revision import code_revision
from reconstruction.errors import BadRunError
from reconstruction.pipeline.artefacts import posed
from reconstruction.pipeline.budget import Budget, StoppedError
from reconstruction.run.configuration import CUDA, STAGES, ReconstructionConfig
from reconstruction.run.folder import RunFolder


def reconstruct(
    recording_path: Path,
    out: Path,
    config: ReconstructionConfig,
    progress_of: Callable[[str], Progress],
    *,
    stage: str | None = None,
    again: int | None = None,
    last: str = STAGES[-1],
    started: float | None = None,
    should_stop: Callable[[], bool] = lambda: False,
    grows: bool = False,
) -> RunFolder:
    """Run every stage up to `last` that is still due, or `stage` alone, and return the run.

    `started` is the process's start on the monotonic clock. With `again` (a number that grows from time to time)
    `stage` and those after it are forgotten first, also in a finished run. With `grows` the recording may still be
    written; then its planes so far are read. Raises BadRunError for a finished run, another configuration, a stage
    whose predecessors are missing, or a device that is not here.
    """
    began = time.monotonic() if started is None else started
    if config.device == CUDA and stage != STAGES[-1]:
        _expect_device()
    recording = config.part_of((open_growing if grows else Recording.open)(recording_path))
    if config.holdout is not None:
        recording.rig.camera(config.holdout)
    undone = STAGES[STAGES.index(stage) :] if again and stage is not None else ()
    if undone:
        RunFolder.open(out)  # raises where there is nothing to undo
    run = RunFolder.start(out, config, recording_path, code_revision(), attempt=(again or 0) if undone else 0)
    with run.locked():
        if undone:
            run.forget(undone, again or 0)
        spent_s = float(sum(run.document.seconds.values()))  # by stages that earlier processes finished
        budget = Budget(time.monotonic, began, spent_s, config.budget_s, config.steps)
        for name in _due(run, stage, last):
            if name != "train":  # which goes on where a killed one was; the others begin anew
                run.document.undo_amendments([name])
            _work(name, run, recording, progress_of(name), budget, should_stop)
            now = time.monotonic()
            trained = name == "train"
            spent = budget.elapsed_s() - sum(run.document.seconds.values()) if trained else now - began
            run.finish_stage(name, spent, last=name == STAGES[-1])
            began = now
    return run


def reconstruct_part(
    recording_path: Path,
    out: Path,
    config: ReconstructionConfig,
    part: str,
    progress: Progress,
    *,
    again: int | None = None,
    should_stop: Callable[[], bool] = lambda: False,
) -> bool:
    """Learn one part of the train stage of a run in spans, beside other processes that learn others.

    Return whether the result was kept: of several processes with the same part, the first one's is. Nothing is written
    into `run.json`, unless `again` asks for the stage to be forgotten first. Raises BadRunError as `reconstruct`, for a
    run without spans, and for a part that the run does not have or that begins with one that is missing.
    """
    if config.device == CUDA:
        _expect_device()
    RunFolder.open(out)  # raises where there is no run
    run = RunFolder.start(out, config, recording_path, code_revision(), attempt=again or 0)
    if again:
        run.forget(STAGES[STAGES.index("train") :], again)
    if not _due(run, "train", STAGES[-1]):
        return False
    if not run.plan.spans:
        raise BadRunError("found a run without spans", "one of a long recording", "leave out --part", where=out)
    from reconstruction.pipeline.parts_training import SpanTraining
    from reconstruction.pipeline.span_stage import learn_part

    recording = posed(run, config.part_of(Recording.open(recording_path)))
    budget = Budget(time.monotonic, time.monotonic(), 0.0, config.budget_s, config.steps)
    return learn_part(SpanTraining(run, recording, progress, budget, should_stop), part)


def _expect_device() -> None:
    """Raise BadRunError where the training would find no device: at the beginning, not after minutes of other work."""
    from reconstruction.rendering.gsplat_backend import expect_device

    expect_device()


def _due(run: RunFolder, stage: str | None, last: str) -> list[str]:
    """Return the stages to run, in order; raises BadRunError where one before `stage` is missing."""
    if stage is None:
        return [name for name in STAGES[: STAGES.index(last) + 1] if not run.has(name)]
    missing = [name for name in STAGES[: STAGES.index(stage)] if not run.has(name)]
    if missing:
        raise BadRunError(f"found no finished stage {missing[0]}", f"it before {stage}", "run it first", where=run.path)
    return [] if run.has(stage) else [stage]


def _work(
    name: str, run: RunFolder, recording: Recording, progress: Progress, budget: Budget, should_stop: Callable[[], bool]
) -> None:
    """Run one stage, imported here: torch, plots and video are for the last two, and listing stages needs none."""

    def stoppable(fraction: float, message: str) -> None:
        """Report progress, and stop a stage without a checkpoint of its own; its artefacts are whole or absent."""
        if should_stop():
            raise StoppedError("stopped", do="the same command resumes it", where=run.path)
        progress(fraction, message)

    if name == "plan":
        from reconstruction.pipeline.plan_stage import plan_stage

        plan_stage(run, recording, stoppable)
    elif name == "poses":
        from reconstruction.pipeline.poses_stage import poses_stage

        poses_stage(run, recording, stoppable)
    elif name == "images":
        from reconstruction.pipeline.images_stage import images_stage

        images_stage(run, recording, stoppable)
    elif name == "points":
        from reconstruction.pipeline.points_stage import points_stage

        points_stage(run, posed(run, recording), stoppable)
    elif name == "train" and run.plan.spans:
        from reconstruction.pipeline.span_stage import train_spans

        train_spans(run, posed(run, recording), progress, budget, should_stop)
    elif name == "train":
        from reconstruction.pipeline.train_stage import train_stage

        train_stage(run, posed(run, recording), progress, budget, should_stop)
    else:
        from reconstruction.pipeline.report_stage import report_stage

        report_stage(run, posed(run, recording, refined=True), stoppable)
