"""The geometry that an initialiser finds in a recording."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from reconstruction.calibration.calibrated import displacement
from reconstruction.errors import BadRunError, GeometryError
from rigs.camera import Camera
from rigs.rig import Rig
from rigs.similarity import Similarity, align

Images = Mapping[str, NDArray[np.float32]]
FEWEST_VIEWS = 3  # views that poses can be found from
WHITE_QUANTILE = 0.995  # share of pixels that are no brighter than white
MOST_TURN_DEG = 15.0  # degrees off its drawing; a solution beyond it is mirrored or wrong
MOST_FOCAL_PERCENT = 25.0  # percent off the rig's focal length


@dataclass(frozen=True, eq=False)
class Geometry:
    """Cameras in the rig frame, and points in it with their confidence.

    `rig` has every camera that was given, aligned by similarity to the rig that was given. `points` [N, 3] in m with
    `confidence` [N] > 0 (larger is better) are empty where the method has none. `plane` is that of an instant at which
    all of them, movers too, were seen; None for points of still things. `report` holds plain values for
    `run.json`: what was found or refused, and why.
    """

    rig: Rig
    points: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 3)))
    confidence: NDArray[np.float32] = field(default_factory=lambda: np.zeros(0, np.float32))
    report: Mapping[str, object] = field(default_factory=dict)
    plane: int | None = None


def usable_views(rig: Rig, images: Images) -> tuple[str, ...]:
    """Return the ids of the cameras that have an image, in the rig's order; BadRunError for one that does not fit."""
    unknown = [c for c in images if c not in rig.ids]
    if unknown:
        raise BadRunError(f"found an image of {unknown[0]}", f"cameras of rig {rig.name}: {', '.join(rig.ids)}")
    if len(images) < FEWEST_VIEWS:
        raise BadRunError(f"found images of {len(images)} cameras", f"at least {FEWEST_VIEWS}")
    for camera_id, image in images.items():
        camera = rig.camera(camera_id)
        if image.shape != (camera.height, camera.width):
            size = f"[{camera.height}, {camera.width}]"
            raise BadRunError(f"found an image of shape {image.shape}", size, where=camera_id)
        if not np.isfinite(image).all():
            raise BadRunError("found NaN or infinity in the image", "spikes per tick", where=camera_id)
        if not image.max() > image.min():
            raise BadRunError("found an image without contrast", "light", "leave this camera out", where=camera_id)
    return tuple(c for c in rig.ids if c in images)


def first_of_one_size(cameras: Sequence[Camera], reason: str) -> Camera:
    """Return the first camera; raises BadRunError with the `reason` where another one has another size."""
    first = cameras[0]
    odd = next((c for c in cameras if (c.width, c.height) != (first.width, first.height)), None)
    if odd:
        expected = f"{first.width}x{first.height} as of {first.id}"
        raise BadRunError(f"found the size {odd.width}x{odd.height}", expected, reason, where=odd.id)
    return first


def toned(images: Images) -> dict[str, NDArray[np.float32]]:
    """Return linear images as a camera would store them, in [0, 1]: the square root, with one white for all of them."""
    white = max(float(np.quantile(np.concatenate([image.ravel() for image in images.values()]), WHITE_QUANTILE)), 1e-9)
    return {c: np.sqrt(np.clip(image / white, 0, 1)).astype(np.float32) for c, image in images.items()}


def laid_on(rig: Rig, found: Rig) -> tuple[Rig, Similarity, dict[str, object]]:
    """Return `rig` with the cameras of `found` in their place, the similarity that took them there, and a report.

    Cameras that were not found stay as they are. Raises GeometryError, by name, where a camera or the focal length lies
    so far from the rig's that the solution cannot be the right one.
    """
    similarity = align(found, rig)
    moved = {c.id: c for c in similarity.carry_rig(found).cameras}
    off = {c: displacement(camera, rig.camera(c)) for c, camera in moved.items()}
    worst = max(off, key=lambda c: off[c].turn_deg)
    if off[worst].turn_deg > MOST_TURN_DEG:
        raise GeometryError(
            f"found {worst} turned {off[worst].turn_deg:.1f} degrees from where the rig has it",
            f"less than {MOST_TURN_DEG:g}",
            "give images with more texture, or keep the rig's poses",
        )
    changed = max((100 * (camera.fx / rig.camera(c).fx - 1) for c, camera in moved.items()), key=abs)
    if abs(changed) > MOST_FOCAL_PERCENT:
        found_focal = f"found a focal length {changed:+.1f}% off the rig's"
        raise GeometryError(found_focal, f"less than {MOST_FOCAL_PERCENT:g}", "keep the rig's focal length")
    report: dict[str, object] = {
        "estimated": list(moved),
        "kept_nominal": [c for c in rig.ids if c not in moved],
        "largest_turn_deg": off[worst].turn_deg,
        "largest_shift_m": max(one.shift_m for one in off.values()),
        "focal_change_percent": changed,
        "scale_from": "the camera centres of the rig that was given",
    }
    return replace(rig, cameras=tuple(moved.get(c.id, c) for c in rig.cameras)), similarity, report
