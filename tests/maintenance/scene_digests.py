"""Digests the evaluation scenes: shapes, textures, light, and poses at fixed instants.

All numbers are rounded far below a pixel or a grey step, so that a digest is the same on every processor. Running this
module writes the committed digests anew, which makes earlier figures incomparable with later ones.
"""

import hashlib

import numpy as np
from numpy.typing import NDArray

from acquisition.durable import write_json
from acquisition.scenes.catalog import EVALUATION, EVALUATION_SEEDS, LONG_EVALUATION, build_scene
from acquisition.scenes.digest import COMMITTED, COMMITTED_LONG
from acquisition.scenes.scene import Scene

INSTANTS_S = np.array([0.0, 0.005, 0.01, 0.02, 0.1])
LONG_INSTANTS_S = np.array([0.0, 0.03, 0.07, 0.11, 0.13, 0.17, 0.2, 0.45, 0.7, 1.0])


def scene_digest(scene: Scene, instants_s: NDArray[np.float64] = INSTANTS_S) -> str:
    """Return the SHA-256, in hexadecimal digits, of all that decides what a camera sees at these instants [n]."""
    geometry, placed = scene.arrays, scene.placements(instants_s)
    light = (scene.white, scene.ambient, scene.background, geometry.uneven.offset, geometry.uneven.least)
    found = hashlib.sha256()
    for numbers in (geometry.shapes, geometry.sun, light, geometry.uneven.slope, *placed):
        found.update((np.round(np.asarray(numbers, dtype=np.float64) * 1e7) + 0.0).astype(np.int64).tobytes())
    for steps in (geometry.ids, geometry.moving, np.round(geometry.textures * 255)):
        found.update(np.asarray(steps).astype(np.uint8).tobytes())
    return found.hexdigest()


def evaluation_digests() -> dict[str, str]:
    """Return the digest of each evaluation scene and seed, by `name-seed`; takes some ten seconds."""
    return {f"{name}-{seed}": scene_digest(build_scene(name, seed)) for name in EVALUATION for seed in EVALUATION_SEEDS}


def long_evaluation_digests() -> dict[str, str]:
    """Return the same of the long evaluation scenes; draws nothing."""
    names = [(name, seed) for name in LONG_EVALUATION for seed in EVALUATION_SEEDS]
    return {f"{name}-{seed}": scene_digest(build_scene(name, seed), LONG_INSTANTS_S) for name, seed in names}


if __name__ == "__main__":
    write_json(COMMITTED, evaluation_digests())
    write_json(COMMITTED_LONG, long_evaluation_digests())
