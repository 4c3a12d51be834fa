"""Plane-sweep stereo with known poses: dense depth in each view, kept where other views agree, and filled.

Cost: a third of a second of one core for 128 hypotheses at 400x250. Fails on texture that repeats along the baselines
or is flat; `consistent` removes most of that, and too few survivors is a StereoError: training does not recover from
bad points.
Source: Collins, CVPR 1996 (plane sweep); Hirschmueller, PAMI 2008 (semi-global matching); ZNCC and best-k by design.
"""

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from acquisition.native import Address
from reconstruction.native import Double, Float, Int, kernel
from reconstruction.parallel import each
from rigs.camera import Camera
from rigs.rig import object_distance_m

Image = NDArray[np.float32]
SOURCES = 4  # nearest views matched against each reference
AGREEING = 2  # other views that must confirm a depth
NOISE = 0.01  # spikes per tick in a scene of ordinary light
AGREEMENT_PX = 1.0  # inverse-depth steps by which a confirming depth may be off

_IMAGES = (Address, Int, Int, Address, Int, Int, Int)
_plane_sweep = kernel("plane_sweep", *_IMAGES, *[Address] * 3, Int, Address, Int, *[Float] * 3, Int, *[Address] * 2)
_confirm_depths = kernel("confirm_depths", Address, Int, Int, *[Address] * 3, Int, Int, Double, Address)


@dataclass(frozen=True)
class SweepOptions:
    """Inverse-depth range in 1/m with its number of planes; window radius in pixels; semi-global penalties.

    `noise`: intensity noise (spikes per tick) below which a patch counts as flat.
    """

    near_m: float
    far_m: float
    planes: int = 128
    radius_px: int = 3
    noise: float = NOISE
    penalty_step: float = 0.06
    penalty_jump: float = 0.6

    @property
    def inverse_depths(self) -> NDArray[np.float64]:
        """The hypotheses [D], far to near, uniform in inverse depth, in 1/m."""
        return np.linspace(1 / self.far_m, 1 / self.near_m, self.planes)


@dataclass(frozen=True, eq=False)
class DepthMap:
    """Depth [H, W] in metres along z, NaN where unknown, and the matching cost [H, W] (1 - ZNCC, 0 is best)."""

    camera: Camera
    depth: Image
    cost: Image


def depth_range_m(cameras: Sequence[Camera]) -> tuple[float, float]:
    """Return the nearest and farthest depth worth searching: half to four times the distance of the object."""
    distance = object_distance_m(cameras)
    return distance / 2, distance * 4


def neighbours(camera: Camera, others: Sequence[Camera], count: int = SOURCES) -> list[int]:
    """Return the indices into `others` of the `count` nearest cameras."""
    gaps = [float(np.linalg.norm(camera.center - other.center)) for other in others]
    return sorted(np.argsort(gaps, kind="stable")[:count].tolist())


def sweep_view(
    reference: tuple[Camera, Image],
    sources: Sequence[tuple[Camera, Image]],
    options: SweepOptions,
    *,
    threads: int | None = None,
) -> DepthMap:
    """Return the depth of every pixel of the reference view, unchecked, in as many threads as processors by default.

    All images [H, W] are linear, in spikes per tick; those of the sources have one size.
    """
    return _swept(reference, sources, options, (options.inverse_depths, None), threads)


def sweep_around(
    reference: tuple[Camera, Image],
    sources: Sequence[tuple[Camera, Image]],
    options: SweepOptions,
    around: Image,
    steps: NDArray[np.floating],
    *,
    threads: int | None = None,
) -> DepthMap:
    """Return the depth of every pixel of the reference view near inverse depths `around` [H, W], unchecked.

    Hypotheses are `steps` [K] beside it, in 1/m and equally spaced. A window is bent as `around` is.
    """
    inside = np.clip(around, options.inverse_depths[0] - steps[0], options.inverse_depths[-1] - steps[-1])
    return _swept(reference, sources, options, (steps, np.ascontiguousarray(inside, dtype=np.float32)), threads)


def _swept(
    reference: tuple[Camera, Image],
    sources: Sequence[tuple[Camera, Image]],
    options: SweepOptions,
    searched: tuple[NDArray[np.floating], Image | None],
    threads: int | None,
) -> DepthMap:
    (camera, image), (hypotheses, around) = reference, searched
    stack = np.ascontiguousarray(np.stack([s for _, s in sources]), dtype=np.float32)
    homographies, epipoles = zip(*(plane_induced(camera, source) for source, _ in sources), strict=True)
    arrays = [np.ascontiguousarray(a, dtype=np.float64) for a in (homographies, epipoles, hypotheses)]
    height, width = image.shape
    depth, cost = np.empty((height, width), np.float32), np.empty((height, width), np.float32)
    flat = np.ascontiguousarray(image, dtype=np.float32)
    numbers = (options.radius_px, options.noise, options.penalty_step, options.penalty_jump)
    team = threads or len(os.sched_getaffinity(0))
    size = (height, width, stack, *stack.shape)
    _plane_sweep(flat, *size, *arrays, len(hypotheses), around, *numbers, team, depth, cost)
    return DepthMap(camera, depth, cost)


def back_project(camera: Camera, depth: Image) -> NDArray[np.float64]:
    """Return the points [H, W, 3] in the rig frame, in m, of depths [H, W] in m along the camera's z."""
    height, width = depth.shape
    x = (np.arange(width) + 0.5 - camera.cx) / camera.fx
    y = (np.arange(height) + 0.5 - camera.cy) / camera.fy
    rays = np.stack([*np.meshgrid(x, y), np.ones((height, width))], axis=-1)
    return camera.cam_from_rig.inverse().apply(rays * depth[..., None])


def back_projected(depth_map: DepthMap, pixels: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the points [n, 3] in the rig frame, in m, that a view sees in `pixels` [n], counted row by row."""
    camera = depth_map.camera
    rows, columns = np.divmod(pixels, camera.width)
    x, y = (columns + 0.5 - camera.cx) / camera.fx, (rows + 0.5 - camera.cy) / camera.fy
    depth = depth_map.depth.ravel()[pixels]
    return camera.cam_from_rig.inverse().apply(np.stack([x, y, np.ones(len(pixels))], axis=-1) * depth[:, None])


def plane_induced(reference: Camera, source: Camera) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return K_s R K_r^-1 [9] and K_s t [3] of the homography that planes facing the reference induce."""
    source_from_reference = source.cam_from_rig @ reference.cam_from_rig.inverse()
    homography = source.K @ source_from_reference.rotation @ np.linalg.inv(reference.K)
    return homography.ravel(), source.K @ source_from_reference.translation


def consistent(maps: Sequence[DepthMap], options: SweepOptions) -> list[DepthMap]:
    """Return the same depths with NaN wherever too few other views see the same surface."""
    tolerance = AGREEMENT_PX * float(np.diff(options.inverse_depths[:2])[0])
    checked = zip(maps, each(lambda i: agreed(maps, i, tolerance), range(len(maps))), strict=True)
    return [replace(one, depth=np.where(sure, one.depth, np.float32(np.nan))) for one, sure in checked]


def agreed(maps: Sequence[DepthMap], number: int, tolerance: float) -> NDArray[np.bool_]:
    """Return where AGREEING other views, or all there are, confirm the depths [H, W] of one; see `confirmations`."""
    others = [other for j, other in enumerate(maps) if j != number]
    return confirmations(maps[number], others, tolerance) >= min(AGREEING, len(others))


def confirmations(reference: DepthMap, others: Sequence[DepthMap], tolerance: float) -> NDArray[np.uint8]:
    """Return how many of the others [H, W] have a depth whose inverse is within `tolerance` (1/m) of the point's."""
    camera = reference.camera
    depth = np.ascontiguousarray(reference.depth, dtype=np.float32)
    votes = np.zeros(depth.shape, np.uint8)
    for other in others:
        seen_by = other.camera
        other_from_reference = seen_by.cam_from_rig @ camera.cam_from_rig.inverse()
        rows = other_from_reference.rotation @ np.linalg.inv(camera.K)
        numbers = np.concatenate([rows.ravel(), other_from_reference.translation])
        pinhole = np.array([seen_by.fx, seen_by.fy, seen_by.cx, seen_by.cy])
        there = np.ascontiguousarray(other.depth, dtype=np.float32)
        _confirm_depths(depth, *depth.shape, numbers, pinhole, there, *there.shape, tolerance, votes)
    return votes


def filled(depth_map: DepthMap) -> DepthMap:
    """Return the map with its unknown depths taken from the nearest known one, or unchanged where none is known."""
    import cv2  # which listing the methods does without

    unknown = ~np.isfinite(depth_map.depth)
    if unknown.all() or not unknown.any():
        return depth_map
    _, found = cv2.distanceTransformWithLabels(
        unknown.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5, labelType=cv2.DIST_LABEL_PIXEL
    )
    labels = np.asarray(found, dtype=np.int64)
    known = np.empty(int(labels.max()) + 1, dtype=np.float32)
    known[labels[~unknown]] = depth_map.depth[~unknown]
    return DepthMap(depth_map.camera, known[labels], depth_map.cost)
