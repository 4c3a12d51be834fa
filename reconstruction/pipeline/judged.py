"""A trained run beside what it is judged by: the truth of the scene, and the held-out camera in its place."""

from dataclasses import dataclass, replace

from acquisition.recording.reader import Recording
from reconstruction.evaluation.evaluate import (
    INSTANTS,
    HeldOut,
    gained_by_spikes,
    held_out_camera,
    placed_by_spikes,
    score_against_counts,
    score_against_truth,
)
from reconstruction.pipeline.artefacts import gains_differ, posed, read_held_out, read_white, write_held_out
from reconstruction.run.folder import RunFolder
from reconstruction.scene_model import SceneModel
from reconstruction.training.checkpoint import load_cloud
from reconstruction.truth import Truth
from rigs.camera import Camera


@dataclass(frozen=True)
class Trained:
    """A trained run: its model, the recording with the cameras it ended with, and how it is judged.

    `truth`: what is known of the scene, in the frame of the run. `held_out`: the camera in its place, None where none
    was held out.
    """

    run: RunFolder
    recording: Recording
    cloud: SceneModel
    truth: Truth | None
    held_out: HeldOut | None

    @property
    def white(self) -> float:
        """The intensity shown as white, spikes per tick."""
        return self.truth.white if self.truth else read_white(self.run)

    @property
    def camera(self) -> Camera:
        """The held-out camera, or the rig's middle one."""
        cameras = self.recording.rig.cameras
        return self.held_out.camera if self.held_out else cameras[len(cameras) // 2]

    def scores(self, cloud: SceneModel, instants: int = INSTANTS) -> dict[str, float]:
        """Score a state of the model on the held-out camera: against the truth at so many instants, or the counts."""
        if self.held_out is None:
            return {}
        if self.truth is None:
            return score_against_counts(cloud, self.held_out)
        return score_against_truth(cloud, self.held_out, self.truth, instants)


def truth_of(run: RunFolder, recording: Recording) -> Truth | None:
    """Return the truth of a simulated recording; None where there is none, or none in the part that was learnt."""
    if recording.truth is None or run.config.holdout is None:
        return None
    truth = Truth.open(recording.truth).within(recording.ticks)
    return truth if recording.part_planes is None or truth.knows(run.config.holdout) else None


def judged(run: RunFolder, recording: Recording, known: Truth | None, *, again: bool = False) -> Trained:
    """Return the trained run with its held-out camera in its place.

    With truth that is the true place, in the light of the training cameras. Without it, a camera that no pose
    estimation has seen is placed by its spikes, as the report kept it, or anew and then kept where `again`; and where
    the cameras differ in gain, its spikes tell its own.
    """
    cloud, camera_id = load_cloud(run.checkpoint), run.config.holdout
    known = known and known.within(recording.ticks)
    if camera_id is None:
        return Trained(run, recording, cloud, known, None)
    held_out, truth = held_out_camera(recording, camera_id, run.plan.views, known)
    estimated = run.document.held_out_used is False and posed(run, recording, refined=True) is not recording
    if truth is None and estimated:
        kept = None if again else read_held_out(run)
        placed = replace(held_out, camera=kept, resected=True) if kept else placed_by_spikes(cloud, held_out)
        if again and placed.resected:
            write_held_out(run, recording.rig, placed.camera)
        held_out = placed
    if truth is None and gains_differ(run):
        held_out = gained_by_spikes(cloud, held_out)
    return Trained(run, recording, cloud, truth, held_out)
