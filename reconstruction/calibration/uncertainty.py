"""The uncertainty of each camera, leaving out what no camera can tell: place, turn and scale of the whole.

Letters: C cameras, G free values.
"""

import numpy as np

from reconstruction.calibration.calibrated import CameraSd
from reconstruction.calibration.problem import Freedom
from reconstruction.calibration.projection import PARAMETERS, Cameras
from rigs.transform import Floats, cross_matrices

POSE = 6
OPTIMISM = 2.0  # variances are taken for so much larger than the sandwich says; on some scenes that is too much


def camera_sds(covariance: Floats, freedom: Freedom, cameras: Cameras, *, metric: bool) -> list[CameraSd]:
    """Return every camera's deviations from the covariance [G, G] of the free values; `metric`: scale is known."""
    count, parameters = len(cameras), len(PARAMETERS)
    mixing = freedom.mixing.reshape(count * parameters, freedom.mixing.shape[2])
    spread = (mixing @ covariance @ mixing.T).reshape(count, parameters, count, parameters)
    poses = spread[:, :POSE, :, :POSE].reshape(count * POSE, count * POSE)
    left = aligning(cameras, metric=metric)
    variances = OPTIMISM * np.diag(left @ poses @ left.T).reshape(count, POSE)
    focal = OPTIMISM * np.array([spread[c, POSE, c, POSE] for c in range(count)]) / cameras.lenses[:, 0] ** 2
    return [
        CameraSd(float(np.degrees(np.sqrt(v[:3].sum()))), float(np.sqrt(v[3:].sum())), float(100 * np.sqrt(f)))
        for v, f in zip(variances, focal, strict=True)
    ]


def aligning(cameras: Cameras, *, metric: bool) -> Floats:
    """Return the matrix [6C, 6C] that takes the mean turn, shift and (unless `metric`) scale out of steps [C, 6].

    It is `rigs.similarity.align` for small steps.
    """
    count = len(cameras)
    apart = cameras.centers - cameras.centers.mean(axis=0)
    turns, centers = np.zeros((count, 3, count, POSE)), np.zeros((count, 3, count, POSE))
    for c in range(count):
        turns[c, :, c, :3] = cameras.rotations[c].T  # in rig axes
        centers[c, :, c, 3:] = np.eye(3)
    mean = turns.mean(axis=0)
    turns = turns - mean
    centers = centers - np.einsum("cij,jdp->cidp", cross_matrices(apart), mean)  # a turn of the whole carries them
    centers = centers - centers.mean(axis=0)
    variance = float((apart**2).sum())
    if not metric and variance > 0:
        scale = np.einsum("ci,cidp->dp", apart, centers) / variance
        centers = centers - apart[:, :, None, None] * scale
    own = np.einsum("cij,cjdp->cidp", cameras.rotations, turns)
    steps = np.concatenate([own, centers], axis=1)
    return np.asarray(steps.reshape(count * POSE, count * POSE), dtype=np.float64)
