"""Crops of photographs as textures of random scenes; none of them is in a scene that anything is scored on."""

import numpy as np
from numpy.typing import NDArray

from acquisition.scenes.realistic.pictures import picture

PHOTOGRAPHS = (  # files that come with packages of the extra `realistic`
    "skimage/rocket.jpg",
    "skimage/motorcycle_left.png",
    "skimage/motorcycle_right.png",
    "skimage/hubble_deep_field.jpg",
    "skimage/retina.jpg",
    "pybullet_data/roboschool/models_outdoor/stadium/stadium_grass.jpg",
    "pybullet_data/heightmaps/gimp_overlay_out.png",
    "pybullet_data/laikago/laikago_tex.jpg",
    "pybullet_data/quadruped/t-motor.jpg",
    "pybullet_data/racecar/meshes/wheel.jpg",
)
SHRINKS = (1, 2)
SPREAD = 0.12  # least standard deviation of a crop's light: an even one is drawn again


def crops(rng: np.random.Generator, count: int, size: int) -> NDArray[np.float32]:
    """Draw `count` textures in 0..1 [count, size, size]: crops of half the size, mirrored so that they go on evenly."""
    found: list[NDArray] = []
    while len(found) < count:
        light = picture(PHOTOGRAPHS[rng.integers(len(PHOTOGRAPHS))], int(rng.choice(SHRINKS)))[..., 0]
        half = size // 2
        if min(light.shape) < half:
            continue
        top, left = (int(rng.integers(side - half + 1)) for side in light.shape)
        crop = light[top : top + half, left : left + half]
        if crop.std() >= SPREAD:
            wide = np.concatenate([crop, crop[:, ::-1]], axis=1)
            found.append(np.concatenate([wide, wide[::-1]]))
    return np.stack(found).astype(np.float32)
