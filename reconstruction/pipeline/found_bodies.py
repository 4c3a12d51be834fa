"""Finds the bodies that the movers of a recording ride on, and settles the motion of its plan by them."""

from collections.abc import Sequence

from acquisition.recording.reader import Recording
from reconstruction.initialization.bodies import Bodies, find_bodies
from reconstruction.initialization.judging import judge
from reconstruction.initialization.points import Points, Seeds
from reconstruction.pipeline import artefacts
from reconstruction.run.decisions import Decision
from reconstruction.run.document import BodyCounts
from reconstruction.run.folder import RunFolder
from reconstruction.run.prices import INSTANTS
from reconstruction.scene_model import TimeSpan


def keep_bodies(run: RunFolder, recording: Recording, moving: Points, planes: Sequence[int]) -> Bodies:
    """Find and keep the bodies among points of movers at `planes`; where none explains the counts, movers go straight.

    The plan is amended only where its motion was left open.
    """
    views, clock = list(artefacts.read_views(run, recording).values()), recording.rig.clock
    found = find_bodies(moving, [clock.instant_s(plane) for plane in planes])
    clip, still = TimeSpan.of_planes(clock, 0, recording.planes), artefacts.read(run, artefacts.STILL, Points)
    cameras = [camera for camera, _ in views]
    seeds = Seeds(still, moving, clip, INSTANTS, run.config.seed, cameras, lambda: found)
    judgement = judge(seeds, views, clock)
    bodies = found.only(judgement.kept)
    artefacts.write(run, artefacts.BODIES, bodies)
    run.document.bodies = BodyCounts(len(bodies), bodies.attached, bodies.free)
    if run.config.model == "auto":
        model = "bases" if len(bodies) else "linear"
        reason = (
            f"{len(bodies)} of {len(found)} rigid bodies explain the counts between the swept instants, "
            f"with {judgement.ratio:.3f} of the error of points at rest"
        )
        facts = {"rigid_bodies": len(bodies), "found_bodies": len(found), "error_ratio": judgement.ratio}
        run.amend("points", Decision("motion", model, reason, "--model", facts=facts), model=model)
    return bodies
