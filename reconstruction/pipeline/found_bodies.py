"""Finds the bodies that the movers of a recording ride on, and settles the motion of its plan by them."""

from collections.abc import Sequence

from acquisition.recording.reader import Recording
from reconstruction.initialization.bodies import Bodies
from reconstruction.initialization.choosing import WHOLE_S, choose_bodies, ways_within
from reconstruction.initialization.judging import judge
from reconstruction.initialization.points import Points, Seeds
from reconstruction.methods.catalogue import METHODS
from reconstruction.pipeline import artefacts
from reconstruction.run.decisions import Decision
from reconstruction.run.document import BodyCounts
from reconstruction.run.folder import RunFolder
from reconstruction.scene_model import TimeSpan


def keep_bodies(run: RunFolder, recording: Recording, moving: Points, planes: Sequence[int]) -> Bodies:
    """Find and keep the bodies among points of movers at `planes`; where none explains the counts, movers go straight.

    The plan is amended only where its motion was left open. Straight paths want more sweeps than bodies (184).
    """
    views, clock = list(artefacts.read_views(run, recording).values()), recording.rig.clock
    clip, still = TimeSpan.of_planes(clock, 0, recording.planes), artefacts.read(run, artefacts.STILL, Points)
    cameras = [camera for camera, _ in views]
    judged = lambda found: judge(  # noqa: E731
        Seeds(still, moving, clip, run.plan.sweeps, run.config.seed, cameras, lambda: found), views, clock
    )
    ways = ways_within(run.config.budget_s, WHOLE_S)
    bodies, found, ratio = choose_bodies(moving, [clock.instant_s(plane) for plane in planes], judged, ways)
    artefacts.write(run, artefacts.BODIES, bodies)
    run.document.bodies = BodyCounts(len(bodies), bodies.attached, bodies.free)
    if run.config.model == "auto":
        model = "bases" if len(bodies) else "linear"
        reason = (
            f"{len(bodies)} of {found} rigid bodies explain the counts between the swept instants, "
            f"with {ratio:.3f} of the error of points at rest"
        )
        facts = {"rigid_bodies": len(bodies), "found_bodies": found, "error_ratio": ratio, "ways": len(ways)}
        run.amend(
            "points",
            Decision("motion", model, reason, "--model", facts=facts),
            model=model,
            sweeps=METHODS[model].sweeps,
        )
    return bodies
