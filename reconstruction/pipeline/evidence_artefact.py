"""The evidence of a run, which its expected errors are told from: one file of the report stage."""

from acquisition.progress import Progress
from reconstruction.gaussians.dynamic import DynamicCloud
from reconstruction.gaussians.spanned import SpannedScene
from reconstruction.pipeline.artefacts import read_white
from reconstruction.pipeline.judged import Trained
from reconstruction.pipeline.span_artefacts import read_targets
from reconstruction.run.folder import RunFolder
from reconstruction.run.spans import Span
from reconstruction.scene_model import SceneModel
from reconstruction.tensors import read_tensors, write_tensors
from reconstruction.uncertainty.evidence import SceneEvidence, gather
from reconstruction.uncertainty.expected_error import Uncertainty

EVIDENCE = "evidence.pt"
DARKEST = 1e-6  # spikes per tick: what white is at least, so that errors can be relative to it


def write_evidence(trained: Trained, progress: Progress) -> Uncertainty | None:
    """Compare a run with its training views, and keep what that tells; return None for a model without Gaussians."""
    run, recording, scene = trained.run, trained.recording, trained.cloud
    if not isinstance(scene, DynamicCloud | SpannedScene):
        return None
    spans = run.plan.spans or (Span(0, recording.planes),)
    views, white = read_targets(run, recording), max(read_white(run), DARKEST)
    evidence = gather(scene, views, recording.rig.clock, spans, white, progress)
    write_tensors(run.path / EVIDENCE, evidence.state())
    return Uncertainty(scene, evidence)


def read_uncertainty(run: RunFolder, scene: SceneModel) -> Uncertainty | None:
    """Return the expected errors of a run's scene; None before its report, and for a model without Gaussians."""
    path = run.path / EVIDENCE
    if not (path.exists() and isinstance(scene, DynamicCloud | SpannedScene)):
        return None
    evidence = SceneEvidence.from_state(read_tensors(path, "the evidence of a run", "run the report stage again"))
    return Uncertainty(scene, evidence)
