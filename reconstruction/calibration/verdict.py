"""Decides whether cameras found from an ordinary scene can be trusted, and says which camera cannot, and why.

A reprojection error does not reveal a wrong minimum; the distance of the rig from its drawing does.
"""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from reconstruction.calibration.adjustment import Solution
from reconstruction.calibration.calibrated import INLIER_PX, CameraSd, Fit, displacement
from reconstruction.calibration.features import Features, Image
from reconstruction.calibration.matches import Matches, Pair, Tracks
from reconstruction.errors import GeometryError
from rigs.rig import Rig
from rigs.similarity import align

DARK = 1e-3  # spikes per tick; twice the dark current of the sensor
LEAST_VIEWS = 3
LEAST_TRACKS = 250
LEAST_OBSERVATIONS = 40  # fewest observations of one camera
LEAST_KEPT = 0.9  # share of observations within INLIER_PX
MOST_SD_DEG = 0.1  # mean over the cameras; worse is seen in the pictures
MOST_TURN_DEG, MOST_SHIFT_M, MOST_FOCAL = 12.5, 0.1, 0.08  # off the drawing: five times what a careful hand is


@dataclass(frozen=True, eq=False)
class Evidence:
    """The images by camera id, the features of each, and what matches between every two of them before any gate.

    `where` are the masks [H, W] that features were looked for in, by camera id; None: everywhere.
    """

    images: Mapping[str, Image]
    features: Sequence[Features]
    candidates: Mapping[Pair, Matches]
    where: Mapping[str, NDArray[np.bool_]] | None = None


def refuse_few(views: Sequence[str], tracks: Tracks) -> Tracks:
    """Return the tracks if they suffice for all views; raises GeometryError naming the views that lack them."""
    seen = tracks.seen.sum(axis=0)
    few = [c for c, n in zip(views, seen, strict=True) if n < LEAST_OBSERVATIONS]
    if few and len(few) < len(seen) - 2:
        raise GeometryError(
            f"found fewer than {LEAST_OBSERVATIONS} tracks in {', '.join(few)}",
            "more as in the others",
            "it is covered, moved, or in another camera's place: mend it or leave it out",
        )
    if len(tracks) < LEAST_TRACKS:
        raise GeometryError(
            f"found {len(tracks)} tracks over {LEAST_VIEWS} or more views",
            f"{LEAST_TRACKS} or more",
            "texture, light or time is too little; move something textured through the scene, or show a board",
        )
    return tracks


def refuse_blind(images: Mapping[str, Image]) -> None:
    """Raise GeometryError for too few views, or naming those without light."""
    if len(images) < LEAST_VIEWS:
        raise GeometryError(f"found {len(images)} views", f"{LEAST_VIEWS} or more to find the cameras from")
    dark = [c for c, image in images.items() if float(np.mean(image)) < DARK]
    if dark:
        raise GeometryError(f"found no light in {', '.join(dark)}", "all views lit", "open the lens or leave it out")


def refuse_unsure(sds: Sequence[CameraSd]) -> float:
    """Return the mean deviation of the turns in degrees; raises GeometryError where the adjustment doubts them."""
    sd_deg = float(np.mean([sd.rotation_deg for sd in sds]))
    if not sd_deg < MOST_SD_DEG:
        raise GeometryError(
            f"found the cameras to {sd_deg:.2f} degrees",
            f"{MOST_SD_DEG:g} or better",
            "texture, light or time is too little; show the cameras something else, or a board",
        )
    return sd_deg


def judge(nominal: Rig, solution: Solution) -> None:
    """Raise GeometryError where the solution is one that must not be believed."""
    kept = Fit.of(solution).good
    share = float(kept.mean())
    per_camera = np.bincount(solution.problem.observations.camera[kept], minlength=len(nominal.cameras))
    if share < LEAST_KEPT:
        raise GeometryError(
            f"found {share:.0%} of the observations within {INLIER_PX:g} px",
            f"{LEAST_KEPT:.0%}",
            "matches contradict one another, as on a pattern that repeats; show the cameras something else, or a board",
        )
    few = [c for c, n in zip(nominal.ids, per_camera, strict=True) if n < LEAST_OBSERVATIONS]
    if few:
        raise GeometryError(
            f"found fewer than {LEAST_OBSERVATIONS} good observations in {', '.join(few)}", do="leave it out"
        )
    focal = solution.moved("focal")
    if abs(focal) > MOST_FOCAL:
        raise GeometryError(
            f"found a focal length {focal:+.1%} off the nominal one",
            f"at most {MOST_FOCAL:.0%}",
            "the scene does not determine it, or the rig file is another array's",
        )
    _refuse_displaced(nominal, solution)


def _refuse_displaced(nominal: Rig, solution: Solution) -> None:
    """Raise GeometryError where a camera is too far off its drawing, naming the one or the two that explain it."""
    found = solution.state.cameras.written_to(nominal)
    if not displaced(found, nominal):
        return
    for one, other in itertools.combinations(nominal.ids, 2):
        if not displaced(found, _exchanged(nominal, one, other)):
            raise GeometryError(
                f"found {one} and {other} in each other's place",
                "them as in the rig file",
                "exchange their streams or their serials",
            )
    for one in nominal.ids:
        others = [c for c in nominal.ids if c != one]
        if not displaced(found.only(others), nominal.only(others)):
            far = displaced(align(found.only(others), nominal).carry_rig(found), nominal, aligned=True)[one]
            raise GeometryError(
                f"found {one} {far}, while the other cameras are where the rig file has them",
                do="it has moved, or sees a pattern that repeats: mend it or leave it out",
            )
    worst, far = max(displaced(found, nominal).items(), key=lambda item: item[1])
    raise GeometryError(
        f"found {worst} {far}",
        f"{100 * MOST_SHIFT_M:g} cm and {MOST_TURN_DEG:g} degrees at most",
        "a pattern that repeats was matched wrongly, or the rig file is another array's",
    )


def displaced(found: Rig, nominal: Rig, *, aligned: bool = False) -> dict[str, str]:
    """Return the cameras farther off their drawing than careful hands leave them, with words that say how far."""
    moved = found if aligned else align(found, nominal).carry_rig(found)
    far = {}
    for camera in moved.cameras:
        off = displacement(camera, nominal.camera(camera.id))
        if off.turn_deg > MOST_TURN_DEG or off.shift_m > MOST_SHIFT_M:
            far[camera.id] = f"{100 * off.shift_m:.1f} cm and {off.turn_deg:.1f} degrees off its place in the rig file"
    return far


def _exchanged(rig: Rig, one: str, other: str) -> Rig:
    """Return the rig with two cameras in each other's place."""
    place = {one: rig.camera(other).cam_from_rig, other: rig.camera(one).cam_from_rig}
    return replace(rig, cameras=tuple(replace(c, cam_from_rig=place.get(c.id, c.cam_from_rig)) for c in rig.cameras))
