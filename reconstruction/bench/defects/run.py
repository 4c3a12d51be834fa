"""Makes one run of the defects bench and scores it."""

import shutil
import time
from pathlib import Path

from acquisition.progress import silent
from acquisition.recording.reader import Recording
from acquisition.revision import code_revision
from reconstruction.bench.conventions import truth_of
from reconstruction.bench.score_run import METRICS, held_out_with_truth
from reconstruction.evaluation.evaluate import score_against_truth
from reconstruction.metrics.poses import pose_errors
from reconstruction.pipeline.artefacts import posed
from reconstruction.pipeline.stages import reconstruct
from reconstruction.run.configuration import ReconstructionConfig
from reconstruction.run.folder import RunFolder
from reconstruction.training.checkpoint import load_cloud
from rigs.rig import object_distance_m


def measured(recording: Path, out: Path, config: ReconstructionConfig) -> dict:
    """Return the scores of a run, its seconds to the end of training, and the errors of poses that were found.

    Deletes the folder `out` of the run. Raises ReconstructionError where the recording is refused.
    """
    shutil.rmtree(out, ignore_errors=True)
    began = time.monotonic()
    try:
        run = reconstruct(recording, out, config, lambda _: silent, last="train")
        seconds = time.monotonic() - began
        own = posed(run, Recording.open(recording), refined=True)
        scores = score_against_truth(load_cloud(run.checkpoint), *held_out_with_truth(own, run.plan.views))
        return {
            "revision": code_revision(),
            "seconds": seconds,
            **{name: scores[name] for name in METRICS if name in scores},
            **_off(own, run),
        }
    finally:
        shutil.rmtree(out, ignore_errors=True)


def _off(recording: Recording, run: RunFolder) -> dict[str, float]:
    """Return how far the cameras that were found are off the true ones; nothing where they were given."""
    true = truth_of(recording).cameras(recording.tick_rate_hz)
    if true is None or run.plan.init == "sweep":
        return {}
    views = run.plan.views
    off = pose_errors(recording.rig.only(views), true.only(views), object_distance_m(true.cameras))
    return {name: getattr(off, name) for name in ("rotation_deg", "translation_percent", "focal_percent")}
