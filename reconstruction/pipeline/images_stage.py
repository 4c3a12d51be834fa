"""Finds the background of every training view: what stays when the movers are taken away."""

from acquisition.progress import Progress
from acquisition.recording.reader import Recording
from reconstruction.images.background import background
from reconstruction.pipeline.artefacts import BACKGROUND, MOVING, read_light, write
from reconstruction.run.folder import RunFolder


def images_stage(run: RunFolder, recording: Recording, progress: Progress) -> None:
    """Find and keep the background of every training view."""
    views, light = run.plan.views, read_light(run)
    for i, view in enumerate(views):
        found = background(recording.stream(view), run.read_array(MOVING.format(view=view)), light)
        write(run, BACKGROUND, found, view)
        progress((i + 1) / len(views), f"background of {view}, {int(found.stuck.sum())} stuck pixels")
