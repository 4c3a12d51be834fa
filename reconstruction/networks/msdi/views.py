"""The cameras of V views as tensors: rays, projection, and the gate that a nominal rig puts on what may correspond.

Letters: V views, N points a view, K inverse depths. Pixels are continuous: the first pixel's centre is (0.5, 0.5).
Inverse depths are along z of the view a point belongs to.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from reconstruction.errors import BadRunError
from rigs.rig import Rig
from rigs.transform import Transform

NEAREST, FARTHEST = 0.3, 8.0  # object distances that anything lies between
GATE = 45 / 350  # distance from the nominal epipolar line, as a share of the focal length
AXIS_SD_RAD = 0.035  # deviation of a nominal axis
USUAL_DISTANCE, USUAL_SPREAD = 8.0, 0.5  # usual distance in scatters of the cameras, and its relative deviation
GATE_STEPS = 3  # inverse depths between which the line is straight
LEAST_Z = 0.05  # least depth of a point in another view, as a share of its own: no division by zero


@dataclass(frozen=True, eq=False)
class Views:
    """V pinhole cameras: `rotation` [V, 3, 3] cam_from_rig, `center` [V, 3] m, `focal` [V, 2], `principal` [V, 2] px.

    `distance` is the object's from the cameras in m.
    """

    rotation: Tensor
    center: Tensor
    focal: Tensor
    principal: Tensor
    distance: float

    def __len__(self) -> int:
        return len(self.rotation)

    @classmethod
    def of_rig(cls, rig: Rig, factor: int = 1, distance: float | None = None) -> Views:
        """Return the cameras of `rig` over pixels `factor` times as large; raises BadRunError for lens distortion."""
        bent = [camera.id for camera in rig.cameras if camera.bends]
        if bent:
            raise BadRunError(f"found lens distortion in {', '.join(bent)}", "none", "msdi is for pinhole cameras")
        stacked = {
            "rotation": [c.cam_from_rig.rotation for c in rig.cameras],
            "center": [c.center for c in rig.cameras],
            "focal": [(c.fx / factor, c.fy / factor) for c in rig.cameras],
            "principal": [(c.cx / factor, c.cy / factor) for c in rig.cameras],
        }
        tensors = {name: torch.tensor(np.array(rows), dtype=torch.float64) for name, rows in stacked.items()}
        return cls(**tensors, distance=object_distance(rig) if distance is None else distance)

    def to_rig(self, rig: Rig, factor: int = 1) -> Rig:
        """Return `rig` with these poses and focal lengths."""
        cameras = []
        for v, camera in enumerate(rig.cameras):
            u, _, vt = np.linalg.svd(self.rotation[v].double().numpy())
            rotation = u @ vt
            pose = Transform(rotation, -rotation @ self.center[v].double().numpy())
            fx, fy = (factor * float(f) for f in self.focal[v])
            cameras.append(replace(camera, cam_from_rig=pose, fx=fx, fy=fy))
        return replace(rig, cameras=tuple(cameras))

    def select(self, which: list[int]) -> Views:
        """Return the views `which`, in that order."""
        parts = (self.rotation[which], self.center[which], self.focal[which], self.principal[which])
        return Views(*parts, self.distance)

    def to(self, kind: torch.dtype | torch.device) -> Views:
        """Return the same in another precision or on another device."""
        parts = (self.rotation, self.center, self.focal, self.principal)
        return Views(*(part.to(kind) for part in parts), distance=self.distance)

    def directions(self, pixels: Tensor) -> Tensor:
        """Return the directions [V, N, 3] of `pixels` [V, N, 2] in each view's own axes, with z = 1."""
        xy = (pixels - self.principal[:, None]) / self.focal[:, None]
        return torch.cat([xy, torch.ones_like(xy[..., :1])], dim=-1)

    def seen_from(self, other: Views, pixels: Tensor, inverse_depth: Tensor) -> tuple[Tensor, Tensor]:
        """Return where all of `other` see the points: pixels [V, N, W, 2] and inverse depth ratio [V, N, W].

        `pixels` [V, N, 2] and `inverse_depth` [V, N] are theirs here. The ratio is the depth there over the depth here;
        where it is not positive the point lies behind, and its pixel is that of a point just in front.
        """
        seen = homogeneous(self, other, self.directions(pixels), inverse_depth)
        ratio = seen[..., 2]
        xy = seen[..., :2] / ratio.clamp_min(LEAST_Z)[..., None]
        return xy * other.focal + other.principal, ratio


def homogeneous(views: Views, other: Views, directions: Tensor, inverse_depth: Tensor) -> Tensor:
    """Return points along `directions` [V, N, 3] in the axes of `other`, times their inverse depth [V, N, W, 3]."""
    in_rig = torch.einsum("vba,vnb->vna", views.rotation, directions)  # rotation transposed: rig_from_cam
    offset = views.center[:, None] - other.center[None]  # [V, W, 3]
    along = in_rig[:, :, None] + inverse_depth[..., None, None] * offset[:, None]
    return torch.einsum("wab,vnwb->vnwa", other.rotation, along)


def object_distance(rig: Rig) -> float:
    """Return the mean distance in m from the cameras to the point their axes come closest to.

    Axes are believed to `AXIS_SD_RAD`; where cameras stand so close that this says little, the point is drawn to where
    cameras that far apart usually look. Raises BadRunError for cameras at one place or turned away from one another.
    """
    centers = np.array([camera.center for camera in rig.cameras])
    axes = np.array([camera.cam_from_rig.rotation[2] for camera in rig.cameras])
    middle, ahead = centers.mean(axis=0), axes.mean(axis=0)
    usual = USUAL_DISTANCE * float(np.sqrt(((centers - middle) ** 2).sum(axis=1).mean()))
    if usual < 1e-6:
        raise BadRunError("found cameras at one place", "them apart", where=f"rig {rig.name}")
    across = (np.eye(3) - axes[:, :, None] * axes[:, None, :]) / (AXIS_SD_RAD * usual) ** 2
    firm = 1 / (USUAL_SPREAD * usual) ** 2
    right = (across @ centers[:, :, None]).sum(axis=0)[:, 0] + firm * (middle + usual * ahead)
    point = np.linalg.solve(across.sum(axis=0) + firm * np.eye(3), right)
    depths = ((point - centers) * axes).sum(axis=1)
    if depths.min() <= 0:
        raise BadRunError("found cameras turned away from one another", "one object in view", where=f"rig {rig.name}")
    return float(np.linalg.norm(point - centers, axis=1).mean())


def inverse_depths(views: Views, count: int) -> Tensor:
    """Return `count` even steps of inverse depth in 1/m from the farthest to the nearest [K]."""
    ends = (1 / (FARTHEST * views.distance), 1 / (NEAREST * views.distance))
    return torch.linspace(*ends, count, dtype=views.center.dtype)


def gate(views: Views, points: Tensor, radius: float = GATE) -> Tensor:
    """Return whether points m of view w may be points n of view v, for the poses as they are [V, N, V, N].

    `points` [V, N, 2] px. A pair passes where either point lies within `radius` focal lengths of the
    other's epipolar line, between the nearest and the farthest depth. No view goes with itself.
    """
    count, number = points.shape[:2]
    passed = torch.zeros(count, number, count, number, dtype=torch.bool)
    steps = inverse_depths(views, GATE_STEPS)
    reach = radius * views.focal.mean()
    for v in range(count):
        one = views.select([v])
        spread = points[v].repeat_interleave(len(steps), dim=0)[None]
        seen, ratio = one.seen_from(views, spread, steps.repeat(number)[None])
        seen = seen.reshape(number, len(steps), count, 2)
        start, end = seen[:, :-1], seen[:, 1:]
        behind = ratio.reshape(number, len(steps), count)[:, 1:] <= LEAST_Z
        for w in range(count):
            if w != v:
                far = _segment_distance(points[w], start[:, :, w], end[:, :, w])  # [N, K - 1, N]
                passed[v, :, w] = (far.masked_fill(behind[:, :, w, None], torch.inf) < reach).any(dim=1)
    return passed & passed.permute(2, 3, 0, 1)


def _segment_distance(points: Tensor, start: Tensor, end: Tensor) -> Tensor:
    """Return the distances [N, K, M] in px from `points` [M, 2] to segments from `start` to `end` [N, K, 2]."""
    along = (end - start)[:, :, None]
    away = points - start[:, :, None]
    share = ((away * along).sum(-1) / (along * along).sum(-1).clamp_min(1e-9)).clamp(0, 1)
    return (away - share[..., None] * along).norm(dim=-1)


def cross_matrices(vectors: Tensor) -> Tensor:
    """Return matrices [..., 3, 3] that multiply as the cross product with `vectors` [..., 3] does."""
    x, y, z = vectors.unbind(dim=-1)
    zero = torch.zeros_like(x)
    return torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], dim=-1).unflatten(-1, (3, 3))
