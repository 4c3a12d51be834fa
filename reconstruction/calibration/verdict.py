"""Whether cameras found from an ordinary scene are to be trusted, and if not, why: which camera, what was found.

A reprojection error tells nothing of a wrong minimum; how far the rig would have to be off its drawing does.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from reconstruction.calibration.features import Features, Image
from reconstruction.calibration.matches import Matches, Pair, Tracks
from reconstruction.calibration.tracks_to_poses import Solution
from reconstruction.errors import GeometryError
from rigs.rig import Rig
from rigs.similarity import align
from rigs.transform import rotvec_of

DARK = 1e-4  # spikes per tick; below it there is no picture
LEAST_VIEWS = 3
LEAST_TRACKS = 250
LEAST_OBSERVATIONS = 40  # of one camera
LEAST_KEPT = 0.9  # share of observations within INLIER_PX
INLIER_PX = 1.0
MOST_TURN_DEG, MOST_SHIFT_M, MOST_FOCAL = 12.5, 0.1, 0.08  # off the drawing: five times what a careful hand does


@dataclass(frozen=True, eq=False)
class Evidence:
    """The nominal rig, the features of its views, and what matches between every two of them before any gate."""

    rig: Rig
    features: Sequence[Features]
    candidates: Mapping[Pair, Matches]

    def enough(self, tracks: Tracks) -> Tracks:
        """The tracks, where they are enough for all views; raises GeometryError naming the views that lack them."""
        seen = tracks.seen.sum(axis=0)
        few = [c for c, n in zip(self.rig.ids, seen, strict=True) if n < LEAST_OBSERVATIONS]
        if few and len(few) < len(seen) - 2:
            raise GeometryError(
                f"found fewer than {LEAST_OBSERVATIONS} tracks in {', '.join(few)}, expected more as in the other views; "
                "it is covered, moved, or in another camera's place: mend it or leave it out"
            )
        if len(tracks) < LEAST_TRACKS:
            raise GeometryError(
                f"found {len(tracks)} tracks over {LEAST_VIEWS} or more views, expected {LEAST_TRACKS}: too little "
                "texture or light, or too short a recording; show the cameras something else, or a board"
            )
        return tracks


def refuse_blind(rig: Rig, images: Mapping[str, Image]) -> None:
    """Raise GeometryError for too few views, or naming those without light."""
    if len(rig.cameras) < LEAST_VIEWS:
        raise GeometryError(f"found {len(rig.cameras)} views, expected {LEAST_VIEWS} or more to find the cameras from")
    dark = [c for c in rig.ids if float(np.mean(images[c])) < DARK]
    if dark:
        raise GeometryError(
            f"found no light in {', '.join(dark)}, expected all views lit; open the lens or leave it out"
        )


def judge(evidence: Evidence, solution: Solution) -> None:
    """Raise GeometryError where the solution is one that must not be believed."""
    nominal = evidence.rig
    residuals = np.linalg.norm(solution.residuals_px(), axis=1)
    kept = residuals < INLIER_PX
    share = float(kept.mean())
    per_camera = np.bincount(solution.problem.observations.camera[kept], minlength=len(nominal.cameras))
    if share < LEAST_KEPT:
        raise GeometryError(
            f"found {share:.0%} of the observations within {INLIER_PX:g} px, expected {LEAST_KEPT:.0%}: matches "
            "contradict one another, as on a pattern that repeats; show the cameras something else, or a board"
        )
    few = [c for c, n in zip(nominal.ids, per_camera, strict=True) if n < LEAST_OBSERVATIONS]
    if few:
        raise GeometryError(
            f"found fewer than {LEAST_OBSERVATIONS} good observations in {', '.join(few)}; leave it out"
        )
    focal = float(solution.state.steps[-1])
    if abs(focal) > MOST_FOCAL:
        raise GeometryError(
            f"found a focal length {focal:+.1%} off the nominal one, expected at most {MOST_FOCAL:.0%}: "
            "the scene does not determine it, or the rig file is another array's"
        )
    _refuse_displaced(nominal, solution)


def _refuse_displaced(nominal: Rig, solution: Solution) -> None:
    found = replace(nominal, cameras=solution.state.cameras.written_to(nominal.cameras))
    moved = align(found, nominal).carry_rig(found)
    for camera, drawn in zip(moved.cameras, nominal.cameras, strict=True):
        turn = np.degrees(np.linalg.norm(rotvec_of(camera.cam_from_rig.rotation @ drawn.cam_from_rig.rotation.T)))
        shift = float(np.linalg.norm(camera.center - drawn.center))
        if turn > MOST_TURN_DEG or shift > MOST_SHIFT_M:
            raise GeometryError(
                f"found {camera.id} {turn:.1f} degrees and {100 * shift:.1f} cm off the rig file, expected at most "
                f"{MOST_TURN_DEG:g} and {100 * MOST_SHIFT_M:g}; a wrong match of a pattern that repeats, or a camera "
                "that is not where the file has it"
            )
