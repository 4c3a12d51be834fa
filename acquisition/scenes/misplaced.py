"""Misplaces the cameras of a rig, as a rig that was not built as its nominal file says."""

from dataclasses import replace

import numpy as np

from rigs.rig import Rig
from rigs.transform import Transform

_MEAN_OF_NORM = np.sqrt(8 / np.pi)  # mean length of a normal vector in space, in its standard deviations


def misplaced(rig: Rig, error: float, seed: int, *, turn_deg: float | None = None) -> Rig:
    """Return `rig` with each camera turned by `error` degrees and moved by `error` cm on average, about random axes.

    The focal length is off by `error` percent, up or down, alike for all lenses. `turn_deg` states the degrees where
    they are to be another number. The poses are marked nominal.
    """
    rng = np.random.default_rng([seed, 0xA1])
    percent = error * rng.choice((-1.0, 1.0))
    turn_sd, center_sd = (x / _MEAN_OF_NORM for x in (error if turn_deg is None else turn_deg, error))
    cameras = []
    for camera in rig.cameras:
        turn = Transform.from_rotvec(np.radians(rng.normal(0, turn_sd, 3)))
        center = camera.center + rng.normal(0, center_sd, 3) / 100
        rotation = turn.rotation @ camera.cam_from_rig.rotation
        focal = {"fx": camera.fx * (1 + percent / 100), "fy": camera.fy * (1 + percent / 100)}
        cameras.append(replace(camera, cam_from_rig=Transform(rotation, -rotation @ center), **focal))
    return replace(rig, cameras=tuple(cameras), poses="nominal", calibration=None)
