"""The error to expect from places around the array, in a table that a browser can interpolate."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from reconstruction.native import shared_out
from reconstruction.report.pictures import of_moderate_size
from rigs.transform import Transform

if TYPE_CHECKING:
    from reconstruction.export.scene import Scene
    from rigs.camera import Camera

FAR = (1.0, 2.0, 4.0)  # distances from the array's middle, in its half diagonal
NEARER = 0.6  # largest share of the way to the scene
SMALL_PX = 30_000  # pixels of a picture whose error is asked for
DIGITS = 5  # of a share of white


def trust_table(scene: Scene, middle_m: np.ndarray) -> dict | None:
    """Return places [P, 3] in m and the expected errors [P] there, roots of mean squares over white.

    Each looks at `middle_m` [3], half-way through the clip. Returns None for a scene without evidence.
    """
    uncertainty, at_s = scene.uncertainty, scene.clip.middle_s
    if uncertainty is None:
        return None

    def expected(camera: Camera) -> float:
        return float(np.sqrt(np.square(uncertainty.look(camera, at_s)).mean()) / max(scene.white, 1e-9))

    places = _places(scene, middle_m)
    first = of_moderate_size(scene.rig.cameras[0].pinhole(), SMALL_PX)
    cameras = [replace(first, cam_from_rig=Transform.looking_at(place, middle_m)) for place in places]
    shares = [round(share, DIGITS) for share in shared_out(expected, cameras)]
    return {"places": np.round(places, 4).tolist(), "of_white": shares}


def _places(scene: Scene, middle_m: np.ndarray) -> np.ndarray:
    """Return the training cameras' centres, and places around the array, before it and behind it, [P, 3] m."""
    rig = scene.rig
    spots = np.stack([camera.center for camera in rig.cameras if camera.id != scene.holdout])
    centre, inner = spots.mean(axis=0), rig.cameras[len(rig.cameras) // 2].cam_from_rig.inverse().rotation
    reach = float(np.linalg.norm(spots - centre, axis=1).max())
    turns = np.arange(8) * np.pi / 4
    aside = np.stack([np.cos(turns), np.sin(turns), np.zeros(8)], axis=1)
    ways = np.concatenate([aside, [[0, 0, 1], [0, 0, -1]]]) @ inner.T
    around = centre + np.concatenate([far * reach * ways for far in FAR])
    sight = middle_m - centre
    along = (around - centre) @ sight / max(float(sight @ sight), 1e-12)
    return np.concatenate([spots, centre[None], around[along <= NEARER]])
