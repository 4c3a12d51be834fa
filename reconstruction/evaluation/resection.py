"""Places a camera that no training saw against the finished scene: its turn and shift, by the spikes it recorded.

Light counted over a few windows is compared with renders, and steps of Gauss and Newton move the camera, from coarse
pictures to fine ones, so that it may begin some twenty pixels off. Intrinsics stay as they are. Cost: some 200 renders.
Source: Lucas & Kanade, "An iterative image registration technique", IJCAI 1981. Letters: H rows, W columns, P pixels.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from reconstruction.images.composite import shrunk
from reconstruction.scene_model import SceneModel
from rigs.camera import Camera
from rigs.transform import Transform

LEVELS = (16, 8, 4, 2, 1)  # factors by which pictures are made smaller
LEAST_PX = 16  # pixels of the shortest side of a picture that is still looked at
STEPS = 12  # most steps at a level
DAMPING = 1e-3  # share of the normal matrix's diagonal that is added to it
ROBUST = 3.0  # median deviations beyond which a pixel pulls no harder
SETTLED_PX = 0.01  # mean movement of pixels in a step below which a level is done

Image = NDArray[np.float32]
Covered = NDArray[np.bool_] | None


class Counted(NamedTuple):
    """The light [H, W] that a camera counted around an instant (s, rig clock), in spikes per tick."""

    instant_s: float
    light: Image


def resected(
    model: SceneModel, camera: Camera, counted: Sequence[Counted], covered: NDArray[np.bool_] | None = None
) -> Camera:
    """Return `camera`, a pinhole, turned and shifted to where the renders of `model` explain best what it counted.

    `covered` [H, W]: the pixels that counted; all where it is None.
    """
    for level in LEVELS:
        small = camera.scaled(max(1, camera.width // level), max(1, camera.height // level))
        if level == 1 or min(small.width, small.height) >= LEAST_PX:
            seen = [Counted(at_s, shrunk(light, small)) for at_s, light in counted]
            good = None if covered is None else shrunk(covered.astype(np.float32), small) == 1
            camera = replace(camera, cam_from_rig=_settled(model, small, seen, good).cam_from_rig)
    return camera


def _settled(model: SceneModel, camera: Camera, counted: Sequence[Counted], covered: Covered) -> Camera:
    """Return the camera where steps no longer lower the error, or no longer move it."""
    best, least = camera, np.inf
    for _ in range(STEPS):
        twist, moved_px, error = _pull(model, camera, counted, covered)
        if not error < least:
            return best
        best, least = camera, error
        if moved_px < SETTLED_PX:
            return best
        camera = replace(camera, cam_from_rig=Transform.from_rotvec(*np.split(twist, 2)) @ camera.cam_from_rig)
    return best


def _pull(
    model: SceneModel, camera: Camera, counted: Sequence[Counted], covered: Covered
) -> tuple[NDArray[np.float64], float, float]:
    """Return the twist [6] (turn in rad, shift in m) to what was counted, what it moves pixels by, and the error."""
    flows, slopes, gaps, errors = [], [], [], []
    for instant_s, light in counted:
        view = model.look(camera, instant_s)
        gap, known = light - view.intensity, np.isfinite(view.depth) & (view.depth > 0)
        if covered is not None:
            gap, known = gap * covered, known & covered
        down, right = (np.asarray(slope) for slope in np.gradient(view.intensity))
        flows.append(_flow(camera, view.depth, known))
        slopes.append(np.stack([right[known], down[known]], axis=1))
        gaps.append(gap[known])
        errors.append(float(np.abs(gap).mean()))
    flow, gap = np.concatenate(flows), np.concatenate(gaps).astype(np.float64)
    change = -np.einsum("pa,pak->pk", np.concatenate(slopes), flow)  # of the light at a pixel, [P, 6]
    width = ROBUST * max(float(np.median(np.abs(gap))), 1e-6) if len(gap) else 1.0
    weighted = change * np.minimum(1.0, width / np.maximum(np.abs(gap), 1e-12))[:, None]
    normal = change.T @ weighted
    normal[np.diag_indices(6)] *= 1 + DAMPING
    twist = np.linalg.lstsq(normal, weighted.T @ gap, rcond=None)[0]
    moved_px = float(np.linalg.norm(flow @ twist, axis=1).mean()) if len(gap) else 0.0
    return twist, moved_px, float(np.mean(errors))


def _flow(camera: Camera, depth: Image, known: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return how the twist moves what the `known` pixels [H, W] see: [P, 2, 6] px, across and down."""
    rows, columns = np.nonzero(known)
    a, b, w = (columns + 0.5 - camera.cx) / camera.fx, (rows + 0.5 - camera.cy) / camera.fy, 1 / depth[known]
    none = np.zeros_like(a)
    across = np.stack([-a * b, 1 + a * a, -b, w, none, -a * w], axis=1) * camera.fx
    down = np.stack([-1 - b * b, a * b, a, none, w, -b * w], axis=1) * camera.fy
    return np.stack([across, down], axis=1).astype(np.float64)
