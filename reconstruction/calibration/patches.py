"""Refines tracks to sub-pixel: an affine least-squares match lays each view's patch on that of a middle view.

Blob features sit off by a tenth of a pixel or two between views; the texture itself does not. Letters: P patches of
S x S pixels. Source: Gruen, "Adaptive least squares correlation", 1985.
"""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from reconstruction.calibration.features import Image, toned
from reconstruction.calibration.matches import Tracks
from rigs.transform import Floats

RADIUS = 7
SMOOTH_PX = 0.7
ROUNDS = 8
MOST_SHIFT_PX = 2.0  # largest way from the feature; further is another place
LEAST_ALIKE = 0.85  # correlation of the patches at the end
LEAST_TEXTURE = 4e-3  # standard deviation of a patch's tone
AXIS = np.arange(-RADIUS, RADIUS + 1, dtype=np.float64)
OFFSETS = np.stack(np.meshgrid(AXIS, AXIS), axis=-1).reshape(-1, 2)  # [S * S, 2], x and y


def refined(tracks: Tracks, images: Sequence[Image]) -> Tracks:
    """Move every place of a track but the reference to where its patch fits; places that do not fit are dropped.

    The reference of a track is the view that is in the middle of those that see it.
    """
    tones = [np.asarray(cv2.GaussianBlur(toned(image), (0, 0), SMOOTH_PX), np.float32) for image in images]
    slopes = [[np.asarray(cv2.Sobel(t, cv2.CV_32F, d, 1 - d, scale=1 / 8), np.float32) for d in (1, 0)] for t in tones]
    reference = _middle_views(tracks.seen)
    places = tracks.places.copy()
    for view in range(places.shape[1]):
        for other in np.unique(reference):
            rows = np.flatnonzero((reference == other) & tracks.seen[:, view])
            if view == other or not len(rows):
                continue
            model = _sampled(tones[other], places[rows, other][:, None] + OFFSETS)
            found, good = _laid(model, tones[view], slopes[view], places[rows, view])
            places[rows, view] = np.where(good[:, None], found, np.nan)
    return Tracks(places)


def _middle_views(seen: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return for each track the view that is nearest to the middle of those that see it, in the rig's order."""
    order = np.arange(seen.shape[1])
    middle = (seen * order).sum(axis=1) / np.maximum(seen.sum(axis=1), 1)
    return np.where(seen, np.abs(order - middle[:, None]), np.inf).argmin(axis=1)


def _laid(model: Floats, tone: Image, slopes: Sequence[Image], start: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """Find the places [P, 2] of the patches `model` [P, S * S] in a view, and which of them can be trusted [P]."""
    warp = np.tile(np.eye(2), (len(start), 1, 1))
    place = start.copy()
    mean, sd = model.mean(axis=1, keepdims=True), model.std(axis=1, keepdims=True)
    good = sd[:, 0] > LEAST_TEXTURE
    wanted = (model - mean) / np.maximum(sd, LEAST_TEXTURE)
    seen = wanted
    for _ in range(ROUNDS):
        at = place[:, None] + OFFSETS @ warp.transpose(0, 2, 1)
        patch, dx, dy = (_sampled(image, at) for image in (tone, *slopes))
        mid, spread = patch.mean(axis=1, keepdims=True), np.maximum(patch.std(axis=1, keepdims=True), LEAST_TEXTURE)
        seen = (patch - mid) / spread
        dx, dy = dx / spread, dy / spread
        x, y = OFFSETS[:, 0], OFFSETS[:, 1]
        slope = np.stack([dx, dy, dx * x, dx * y, dy * x, dy * y, np.ones_like(dx), seen], axis=2)
        normal = slope.transpose(0, 2, 1) @ slope
        normal += np.eye(8) * (1e-6 * np.einsum("pii->pi", normal).max(axis=1))[:, None, None]
        step = np.linalg.solve(normal, slope.transpose(0, 2, 1) @ (wanted - seen)[:, :, None])[:, :, 0]
        step = np.clip(np.nan_to_num(step), -1, 1)
        place = place + step[:, :2]
        warp = warp + 0.5 * step[:, 2:6].reshape(-1, 2, 2)
    alike = (seen * wanted).mean(axis=1)
    near = np.linalg.norm(place - start, axis=1) < MOST_SHIFT_PX
    height, width = tone.shape
    inside = np.all((place > RADIUS / 2) & (place < (width - RADIUS / 2, height - RADIUS / 2)), axis=1)
    return place, good & near & (alike > LEAST_ALIKE) & inside


def _sampled(image: Image, at: Floats) -> Floats:
    """Sample an image at places [P, n, 2] in px by cubic interpolation, to [P, n]."""
    x, y = (np.ascontiguousarray(at[:, :, axis] - 0.5, dtype=np.float32) for axis in (0, 1))
    found = [
        cv2.remap(image, x[i : i + 30000], y[i : i + 30000], cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
        for i in range(0, len(x), 30000)  # OpenCV takes no more than 32767 rows
    ]
    return np.concatenate(found).astype(np.float64)
