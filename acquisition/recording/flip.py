"""Suspects that the cameras of a rig were read upside down, from what they see of one another's view.

A single picture does not show that it is upside down; several do. Where the rows of all cameras are reversed, a surface
seems to move the wrong way between cameras that stand above each other, and no depth fits those beside and those above
at once. A plane sweep of the mean images over the rig's own cameras measures how well the best depths fit, read both
ways.

Letters: H rows, W columns of the reduced pictures, C cameras, D depths.
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from rigs.camera import Camera
from rigs.rig import Rig

Floats = NDArray[np.float64]
ACROSS = 100  # columns of a reduced picture
DEPTHS = 32
NEAREST, FARTHEST = 1.2, 40.0  # depths in widths of the rig
BETTER, LEAST = 0.1, 0.4  # least gain of correlation by reversing the rows, least correlation then
_WINDOW = 9  # side of the window of a correlation, in pixels
_LEAST_CONTRAST = 1e-3  # least standard deviation in a window, in spikes per tick


def suspected_flip(rig: Rig, means: Mapping[str, Floats]) -> str | None:
    """Return a line that says why rows seem reversed, or None; `means` are images [H, W] in spikes per tick."""
    centers = np.array([camera.center for camera in rig.cameras])
    width = float(np.linalg.norm(np.ptp(centers, axis=0)))
    if len(rig.cameras) < 3 or width == 0:
        return None
    given, reversed_ = (_fit(rig, means, width, flipped) for flipped in (False, True))
    if not reversed_ > max(given + BETTER, LEAST):
        return None
    return (
        f"views of neighbouring cameras fit one another with a correlation of {given:.2f} as read and of "
        f"{reversed_:.2f} with their rows reversed; import with the other --row-order"
    )


def _fit(rig: Rig, means: Mapping[str, Floats], width: float, flipped: bool) -> float:
    """Return the mean correlation in [-1, 1] of the other cameras with the middle one, each patch at its best depth."""
    cameras, pictures = [], []
    for camera in rig.cameras:
        image = means[camera.id][::-1] if flipped else means[camera.id]
        step = max(1, camera.width // ACROSS)
        pictures.append(_reduced(image, step))
        cameras.append(camera.scaled(camera.width // step, camera.height // step))
    centers = np.array([camera.center for camera in cameras])
    middle = int(np.argmin(np.linalg.norm(centers - centers.mean(axis=0), axis=1)))
    others = [k for k in range(len(cameras)) if k != middle]
    depths = 1 / np.linspace(1 / (NEAREST * width), 1 / (FARTHEST * width), DEPTHS)
    best = np.full(pictures[middle].shape, -1.0)
    for depth in depths:
        fits = [_correlation(pictures[middle], _seen(cameras[middle], cameras[k], pictures[k], depth)) for k in others]
        known = np.mean(~np.isnan(fits), axis=0) > 0.5
        mean = np.nansum(fits, axis=0) / np.maximum(1, (~np.isnan(fits)).sum(axis=0))
        best = np.where(known, np.maximum(best, mean), best)
    told = best > -1
    return float(best[told].mean()) if told.any() else 0.0


def _reduced(image: Floats, step: int) -> Floats:
    """Average over step x step pixels."""
    rows, columns = image.shape[0] // step, image.shape[1] // step
    return image[: rows * step, : columns * step].reshape(rows, step, columns, step).mean(axis=(1, 3))


def _seen(reference: Camera, other: Camera, picture: Floats, depth: float) -> Floats:
    """Return what `other` sees at `depth` metres along the axis of `reference`, by its pixels [H, W]; NaN outside."""
    v, u = np.mgrid[0.5 : reference.height, 0.5 : reference.width]
    rays = np.stack([(u - reference.cx) / reference.fx, (v - reference.cy) / reference.fy, np.ones_like(u)], axis=-1)
    pixels, inside = other.project(reference.cam_from_rig.inverse().apply(depth * rays).reshape(-1, 3))
    columns, rows = np.where(inside[:, None], pixels, 0).astype(np.int64).T
    return np.where(inside, picture[rows, columns], np.nan).reshape(u.shape)


def _correlation(a: Floats, b: Floats) -> Floats:
    """Correlate two pictures in a window around each pixel [H, W]; NaN where either is even or not known."""
    mean_a, mean_b = _box(a), _box(b)
    spread_a, spread_b = _box(a * a) - mean_a**2, _box(b * b) - mean_b**2
    told = (spread_a > _LEAST_CONTRAST**2) & (spread_b > _LEAST_CONTRAST**2)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(told, (_box(a * b) - mean_a * mean_b) / np.sqrt(spread_a * spread_b), np.nan)


def _box(a: Floats) -> Floats:
    """Average over a window around each pixel [H, W]; NaN at the border and wherever the window holds one."""
    padded = np.pad(a, _WINDOW // 2, constant_values=np.nan)
    sums = np.sum([padded[k : k + a.shape[0]] for k in range(_WINDOW)], axis=0)
    return np.sum([sums[:, k : k + a.shape[1]] for k in range(_WINDOW)], axis=0) / _WINDOW**2
