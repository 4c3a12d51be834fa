"""Finds the points of a calibration board in one picture, to a few hundredths of a pixel.

1. OpenCV's detector finds the tags, in a picture made twice as large because it wants cells of several pixels.
2. Tags that do not lie as the board says are dropped (one homography, RANSAC).
3. Each point is sought anew in the linear picture, by the straight edges that make it. Borders between the squares of a
   ChArUco board meet in its points. The sides of a tag meet in its corners, and its diagonals in its middle.
An edge passes where the light, integrated across it, has stepped from black to white. Blur that is alike on both sides
does not shift it, whether it comes from pixels, interpolation or motion. Without noise points are exact to 0.01 px,
where `cv2.cornerSubPix` errs by 0.04 px at squares. Corners of moving tags lie 0.01 px too far out, because dark pixels
remember light longer; their middles do not.

Letters: T tags, N points, B tags or points, E edges of each, S samples along an edge, O offsets across it.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from reconstruction.calibration.board_spec import BoardSpec, predefined
from rigs.transform import Floats

Image = NDArray[np.float32]
LARGEST_TO_ENLARGE = 1000  # pixels a side of the picture
LAYOUT_PX = 3.0  # largest distance of a tag's corner from where the board's homography has it
LEAST_POINTS = 4
WHITE_PERCENTILE = 99.0
_DEFECT_STEP = 0.2  # distance of a hot or dead pixel from its neighbours' range, as a share of white
_INSET_PX = 2.5  # part left out at either end of an edge, at least a tenth of it
_ALONG, _ACROSS = 24, 17  # samples
_PASSES = 3


@dataclass(frozen=True, eq=False)
class Sighting:
    """The points of a board that one picture has: indices [n] into its points and pixels [n, 2] (x, y).

    `tags` ids of the dictionary were seen and `fitting` of these tags lie as the board says.
    """

    points: NDArray[np.int64]
    pixels: Floats
    tags: tuple[int, ...] = ()
    fitting: int = 0


def find_board(image: Image, board: BoardSpec) -> Sighting:
    """Find the points of `board` in a linear picture [H, W], spikes per tick; none where fewer than four fit."""
    image = without_defects(image)
    ids, quads = find_tags(image, board.dictionary)
    nothing = Sighting(np.zeros(0, dtype=np.int64), np.zeros((0, 2)), tuple(ids.tolist()))
    fit = ids < len(board.tags)
    fit[fit] = _as_laid_out(board.tags[ids[fit]], quads[fit])
    ids, quads = ids[fit], quads[fit]
    if not len(ids):
        return nothing
    points, pixels = (_square_corners if board.kind == "charuco" else _tag_middles)(image, board, ids, quads)
    height, width = image.shape
    inside = (pixels > 1).all(axis=1) & (pixels < [width - 1, height - 1]).all(axis=1)
    if inside.sum() < LEAST_POINTS:
        return Sighting(nothing.points, nothing.pixels, nothing.tags, len(ids))
    return Sighting(points[inside], pixels[inside], nothing.tags, len(ids))


def find_tags(image: Image, dictionary: str) -> tuple[NDArray[np.int64], Floats]:
    """Find the tags in a picture: ids [T], each once, and corners [T, 4, 2] in px, clockwise from the top left."""
    white = max(float(np.percentile(image, WHITE_PERCENTILE)), 1e-6)
    grey = (np.clip(image / white, 0, 1) * 255).astype(np.uint8)
    times = 2 if max(grey.shape) <= LARGEST_TO_ENLARGE else 1
    if times > 1:
        grey = cv2.resize(grey, None, fx=times, fy=times, interpolation=cv2.INTER_CUBIC)
    found, ids, _ = cv2.aruco.ArucoDetector(predefined(dictionary)).detectMarkers(grey)
    if ids is None or not len(found):
        return np.zeros(0, dtype=np.int64), np.zeros((0, 4, 2))
    flat = np.asarray(ids, dtype=np.int64).ravel()
    once = np.array([(flat == i).sum() == 1 for i in flat])
    order = np.argsort(flat[once])
    corners = (np.array(found, dtype=np.float64).reshape(-1, 4, 2) + 0.5) / times
    return flat[once][order], corners[once][order]


def without_defects(image: Image) -> Image:
    """Replace hot and dead pixels of a picture [H, W], those beyond all their neighbours, by the median around them."""
    ring = np.ones((3, 3), dtype=np.uint8)
    ring[1, 1] = 0
    step = _DEFECT_STEP * float(np.percentile(image, WHITE_PERCENTILE))
    out = (image > cv2.dilate(image, ring) + step) | (image < cv2.erode(image, ring) - step)
    return np.where(out, cv2.medianBlur(image, 3), image).astype(np.float32)


def _as_laid_out(tags: Floats, quads: Floats) -> NDArray[np.bool_]:
    """Return which tags [T] lie on one homography, from their corners on the board [T, 4, 3] and seen [T, 4, 2]."""
    flat, seen = tags[..., :2].reshape(-1, 2), quads.reshape(-1, 2)
    if len(tags) < 2:
        return np.ones(len(tags), dtype=bool)
    cv2.setRNGSeed(0)
    matrix, _ = cv2.findHomography(flat, seen, cv2.RANSAC, LAYOUT_PX)
    if matrix is None:
        return np.zeros(len(tags), dtype=bool)
    off = np.linalg.norm(cv2.perspectiveTransform(flat[:, None], matrix)[:, 0] - seen, axis=1).reshape(-1, 4)
    return np.asarray(off.max(axis=1) < LAYOUT_PX)


def _square_corners(
    image: Image, board: BoardSpec, ids: NDArray[np.int64], quads: Floats
) -> tuple[NDArray[np.int64], Floats]:
    """Find the corners of squares both of whose tags were found: where two borders between squares meet."""
    square = board.points[1, 0] - board.points[0, 0]
    points = np.flatnonzero(np.isin(board.tags_of, ids).all(axis=1))
    if not len(points):
        return points, np.zeros((0, 2))
    steps = np.array([(0, 0), (square, 0), (-square, 0), (0, -square), (0, square), (board.margin_m, 0)])
    seen = np.zeros((len(points), 6, 2))
    for n, point in enumerate(points):
        near = np.isin(ids, board.tags_of[point])
        matrix, _ = cv2.findHomography(board.tags[ids[near]][..., :2].reshape(-1, 2), quads[near].reshape(-1, 2))
        around = board.points[point, :2] + steps
        seen[n] = cv2.perspectiveTransform(around[:, None], matrix)[:, 0]
    reach = _reach(np.linalg.norm(seen[:, 5] - seen[:, 0], axis=1))
    white_above = np.round(board.points[points].sum(axis=1) / square).astype(np.int64) % 2 == 0  # a step along +x
    outward = np.stack([white_above, white_above, ~white_above, ~white_above], axis=1)[..., None]
    corners = seen[:, 0]
    for _ in range(_PASSES):
        here, there = np.broadcast_to(corners[:, None], (len(points), 4, 2)), seen[:, 1:5]
        edges = _edges(image, np.where(outward, here, there), np.where(outward, there, here), reach)
        lines = _lines(edges.reshape(len(points), 2, -1, 2))
        corners = _meetings(lines[:, 0], lines[:, 1])
    near = np.abs(corners - seen[:, 0]).max(axis=1) < 2 * reach
    return points[near], corners[near]


def _tag_middles(
    image: Image, board: BoardSpec, ids: NDArray[np.int64], quads: Floats
) -> tuple[NDArray[np.int64], Floats]:
    """Find the middles of tags: each corner is where two sides meet, each middle where two diagonals meet."""
    cells = predefined(board.dictionary).markerSize + 2
    reach = _reach(np.linalg.norm(np.roll(quads, -1, axis=1) - quads, axis=2).min(axis=1) / cells)
    corners = quads
    for _ in range(_PASSES):
        lines = _lines(_edges(image, corners, np.roll(corners, -1, axis=1), reach))
        corners = _meetings(np.roll(lines, 1, axis=1), lines)
    near = np.abs(corners - quads).max(axis=(1, 2)) < 2 * reach
    diagonals = [_lines(corners[:, [k, k + 2]]) for k in (0, 1)]
    return ids[near], _meetings(diagonals[0], diagonals[1])[near]


def _reach(clear_px: Floats) -> Floats:
    """Return how far across an edge to look in px, where the next edge is `clear_px` away."""
    return np.clip(0.55 * clear_px, 1.0, 3.0)


def _edges(image: Image, starts: Floats, ends: Floats, reach: Floats) -> Floats:
    """Find points [B, E, S, 2] on the edges near starts to ends [B, E, 2], white to their left, black to their right.

    NaN where there is no such edge. `reach` [B] is how far to look across.
    """
    along = ends - starts
    length = np.linalg.norm(along, axis=-1, keepdims=True)  # [B, E, 1]
    inset = np.maximum(_INSET_PX / np.maximum(length, 1e-9), 0.1)
    normal = np.stack([along[..., 1], -along[..., 0]], axis=-1) / np.maximum(length, 1e-9)
    shares = inset + (1 - 2 * inset) * np.linspace(0, 1, _ALONG)  # [B, E, S]
    middle = starts[..., None, :] + shares[..., None] * along[..., None, :]  # [B, E, S, 2]
    offsets = reach[:, None] * np.linspace(-1, 1, _ACROSS)  # [B, O]
    at = middle[..., None, :] + offsets[:, None, None, :, None] * normal[..., None, None, :] - 0.5
    x, y = (np.ascontiguousarray(at[..., k], dtype=np.float32).reshape(-1, _ALONG * _ACROSS) for k in (0, 1))
    light = cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE).reshape(at.shape[:-1])
    black, white = (light[..., k].mean(axis=(-2, -1)) for k in (slice(None, 2), slice(-2, None)))
    seen = (white > black) & (length[..., 0] > 2 * _INSET_PX + 3)
    step = np.where(seen, white - black, np.nan)[..., None, None]
    risen = (light - black[..., None, None]) / step
    area = (risen[..., 1:] + risen[..., :-1]).sum(axis=-1) / (_ACROSS - 1)  # of the reach
    return middle + ((1 - area) * reach[:, None, None])[..., None] * normal[..., None, :]


def _lines(points: Floats) -> Floats:
    """Fit lines (a, b, c) [..., 3] with a x + b y = c to points [..., S, 2] by least squares; NaN for NaN."""
    middle = points.mean(axis=-2)
    spread = points - middle[..., None, :]
    xx, yy, xy = (spread**2).sum(axis=-2)[..., 0], (spread**2).sum(axis=-2)[..., 1], spread.prod(axis=-1).sum(axis=-1)
    angle = np.arctan2(2 * xy, xx - yy) / 2 + np.pi / 2
    normal = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    return np.concatenate([normal, (normal * middle).sum(axis=-1, keepdims=True)], axis=-1)


def _meetings(ones: Floats, others: Floats) -> Floats:
    """Return where pairs of lines [..., 3] meet [..., 2]; infinitely far or NaN where they do not."""
    (a, b, c), (d, e, f) = np.moveaxis(ones, -1, 0), np.moveaxis(others, -1, 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.stack([c * e - b * f, a * f - c * d], axis=-1) / (a * e - b * d)[..., None]
