"""`reconstruct`: the stages in order, each timed, each skipped where its artefacts are already there."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from acquisition.progress import Progress
from acquisition.recording.reader import Recording
from acquisition.revision import code_revision
from reconstruction.errors import BadRunError
from reconstruction.pipeline.budget import Budget, StoppedError, process_budget
from reconstruction.pipeline.poses import posed, poses_stage
from reconstruction.pipeline.stages import images_stage, plan_stage, points_stage
from reconstruction.run.configuration import STAGES, ReconstructionConfig
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
) -> RunFolder:
    """Run every stage up to `last` that is still due, or just `stage`.

    `started` is the process's start on the monotonic clock. With `again` (a number that grows from time to time)
    `stage` and those after it are forgotten first, also in a finished run.
    Raises BadRunError for a finished run, another configuration, or a stage whose predecessors are missing.
    """
    began = time.monotonic() if started is None else started
    recording = Recording.open(recording_path)
    if config.holdout is not None:
        recording.rig.camera(config.holdout)
    if again is not None and stage is not None:
        RunFolder.open(out).forget(STAGES[STAGES.index(stage) :], again)
    run = RunFolder.start(out, config, recording_path, {"revision": code_revision(), "backend": "native"})

    def stoppable(progress: Progress) -> Progress:
        """Stages without a checkpoint of their own stop wherever they report; their artefacts are whole or absent."""

        def report(fraction: float, message: str) -> None:
            if should_stop():
                raise StoppedError("stopped", do="the same command resumes it", where=run.path)
            progress(fraction, message)

        return report

    with run.locked():
        budget = process_budget(run, began)
        work: dict[str, Callable[[Progress], None]] = {
            "plan": lambda p: plan_stage(run, recording, stoppable(p)),
            "poses": lambda p: poses_stage(run, recording, stoppable(p)),
            "images": lambda p: images_stage(run, recording, stoppable(p)),
            "points": lambda p: points_stage(run, posed(run, recording), stoppable(p)),
            "train": lambda p: _train(run, posed(run, recording), p, budget, should_stop),
            "report": lambda p: _report(run, posed(run, recording, refined=True), stoppable(p)),
        }
        for name in _due(run, stage, last):
            work[name](progress_of(name))
            now = time.monotonic()
            trained = name == "train"
            spent = budget.elapsed_s() - sum(run.document["seconds"].values()) if trained else now - began
            run.finish_stage(name, spent, last=name == STAGES[-1])
            began = now
    return run


def _train(
    run: RunFolder, recording: Recording, progress: Progress, budget: Budget, should_stop: Callable[[], bool]
) -> None:
    from reconstruction.pipeline.training import train_stage  # torch, which the stages before do without

    train_stage(run, recording, progress, budget, should_stop)


def _report(run: RunFolder, recording: Recording, progress: Progress) -> None:
    from reconstruction.pipeline.report import report_stage  # plots and video, when the budget is spent

    report_stage(run, recording, progress)


def _due(run: RunFolder, stage: str | None, last: str) -> list[str]:
    if stage is None:
        return [name for name in STAGES[: STAGES.index(last) + 1] if not run.has(name)]
    missing = [name for name in STAGES[: STAGES.index(stage)] if not run.has(name)]
    if missing:
        raise BadRunError(f"found no finished stage {missing[0]}", f"it before {stage}", "run it first", where=run.path)
    return [] if run.has(stage) else [stage]
