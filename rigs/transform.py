"""Rigid transforms between frames. `target_from_source` names compose and cancel: `c_from_w = c_from_r @ r_from_w`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rigs.errors import RigError

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Transform:
    """`x_in_target = rotation @ x_in_source + translation`; rotation [3, 3], translation [3] in metres.

    Raises RigError for values that are not finite or a matrix that is not a rotation (1e-6).
    """

    rotation: Floats
    translation: Floats

    def __post_init__(self) -> None:
        rotation = np.asarray(self.rotation, dtype=np.float64)
        translation = np.asarray(self.translation, dtype=np.float64)
        if rotation.shape != (3, 3) or translation.shape != (3,):
            raise RigError(f"found a pose of shapes {rotation.shape} and {translation.shape}", "(3, 3) and (3,)")
        if not (np.isfinite(rotation).all() and np.isfinite(translation).all()):
            raise RigError("found a pose with NaN or infinity", "finite numbers", "mend the pose")
        if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-6 or np.linalg.det(rotation) < 0:
            raise RigError("found a matrix that is not a rotation", "orthonormal with determinant +1")
        object.__setattr__(self, "rotation", rotation)
        object.__setattr__(self, "translation", translation)

    @classmethod
    def identity(cls) -> Transform:
        """Return the transform that changes nothing."""
        return cls(np.eye(3), np.zeros(3))

    @classmethod
    def from_quat_wxyz(cls, quat_wxyz: ArrayLike, translation: ArrayLike) -> Transform:
        """Build from a quaternion (w, x, y, z) of any non-zero length and a translation [3] in metres."""
        q = np.asarray(quat_wxyz, dtype=np.float64)
        with np.errstate(over="ignore"):
            length = np.linalg.norm(q)
        if q.shape != (4,) or not np.isfinite(length) or length == 0:
            raise RigError(f"found the quaternion {q.tolist()}", "four finite numbers, not all zero")
        w, x, y, z = q / length
        rotation = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ]
        )
        return cls(rotation, np.asarray(translation, dtype=np.float64))

    @classmethod
    def from_rotvec(cls, rotvec: ArrayLike, translation: ArrayLike = (0.0, 0.0, 0.0)) -> Transform:
        """Build a turn about `rotvec` [3] by its length in radians (Rodrigues), then a translation [3] in metres."""
        return cls(rotations(rotvec), np.asarray(translation, dtype=np.float64))

    @classmethod
    def looking_at(cls, center: ArrayLike, target: ArrayLike, down: ArrayLike = (0.0, 1.0, 0.0)) -> Transform:
        """Return `cam_from_world` of a camera at `center` whose +z meets `target` and +y leans to `down`, each [3]."""
        origin = np.asarray(center, dtype=np.float64)
        forward = np.asarray(target, dtype=np.float64) - origin
        right = np.cross(np.asarray(down, dtype=np.float64), forward)
        if np.linalg.norm(right) < 1e-12:
            raise RigError("found a camera that looks along its own vertical", "another direction")
        forward = forward / np.linalg.norm(forward)
        right = right / np.linalg.norm(right)
        rotation = np.stack([right, np.cross(forward, right), forward])
        return cls(rotation, -rotation @ origin)

    def __matmul__(self, other: Transform) -> Transform:
        return Transform(self.rotation @ other.rotation, self.rotation @ other.translation + self.translation)

    def inverse(self) -> Transform:
        """Return `source_from_target`."""
        return Transform(self.rotation.T, -self.rotation.T @ self.translation)

    def apply(self, points: ArrayLike) -> Floats:
        """Carry points [..., 3] of the source frame into the target frame."""
        return np.asarray(points, dtype=np.float64) @ self.rotation.T + self.translation

    @property
    def matrix(self) -> Floats:
        """The homogeneous matrix [4, 4]."""
        m = np.eye(4)
        m[:3, :3] = self.rotation
        m[:3, 3] = self.translation
        return m

    @property
    def center(self) -> Floats:
        """The target frame's origin in the source frame [3], metres; for `cam_from_world`, the camera centre."""
        return -self.rotation.T @ self.translation

    @property
    def quat_wxyz(self) -> Floats:
        """Unit quaternion (w, x, y, z) with w >= 0 (Shepperd's method: the largest component first)."""
        r = self.rotation
        trace = np.trace(r)
        diagonal = np.array([trace, r[0, 0], r[1, 1], r[2, 2]])
        k = int(np.argmax(diagonal))
        if k == 0:
            q = np.array([1 + trace, r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]])
        else:
            i, j, l = [(0, 1, 2), (1, 2, 0), (2, 0, 1)][k - 1]  # noqa: E741
            q = np.empty(4)
            q[0] = r[l, j] - r[j, l]
            q[1 + i] = 1 + r[i, i] - r[j, j] - r[l, l]
            q[1 + j] = r[j, i] + r[i, j]
            q[1 + l] = r[l, i] + r[i, l]
        q = q / np.linalg.norm(q)
        return q if q[0] >= 0 else -q


def rotations(rotvecs: ArrayLike) -> Floats:
    """Turn rotation vectors [..., 3] in radians into matrices [..., 3, 3] by Rodrigues' formula, exact through zero."""
    r = np.asarray(rotvecs, dtype=np.float64)
    angle = np.linalg.norm(r, axis=-1)[..., None, None]
    cross = cross_matrices(r)
    half = np.sinc(angle / (2 * np.pi))  # sin(a/2) / (a/2)
    return np.eye(3) + np.sinc(angle / np.pi) * cross + half**2 / 2 * (cross @ cross)


def cross_matrices(vectors: ArrayLike) -> Floats:
    """Return matrices [..., 3, 3] that multiply as the cross product with `vectors` [..., 3] does."""
    x, y, z = np.moveaxis(np.asarray(vectors, dtype=np.float64), -1, 0)
    zero = np.zeros_like(x)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(*x.shape, 3, 3)


def rotvec_of(rotation: ArrayLike) -> Floats:
    """Return the rotation vector [3] in radians, at most pi long, of a rotation matrix [3, 3]."""
    w, *axis = Transform(np.asarray(rotation, dtype=np.float64), np.zeros(3)).quat_wxyz
    sine = float(np.linalg.norm(axis))
    angle = 2 * np.arctan2(sine, w)
    return np.array(axis) * (angle / sine if sine > 1e-12 else 2.0)
