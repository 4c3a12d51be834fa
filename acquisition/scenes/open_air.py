"""Scenes without a back wall, for developing backgrounds that are far, empty or dark: the demo's things and movers.

Whatever is not hit by a ray shows the scene's `background`: an even sky, or nothing.
"""

import numpy as np

from acquisition.scenes import textures
from acquisition.scenes.bodies import Finish, still
from acquisition.scenes.demo import FLOOR_Y_M, PEBBLES, SPECKLE, STANDING, furnish, movers
from acquisition.scenes.scene import Scene
from acquisition.scenes.stage import Stage

SKY = 0.4  # spikes per tick
FIELD_M = 20.0  # reach of the ground under the sky
FAR_M, HILLS_M = 40.0, (70.0, 30.0)  # distance and half size of a far picture


def sky(seed: int) -> Scene:
    """Build the demo on a field that ends 20 m away, under an even sky."""
    return _scene("sky", seed, SKY, hills=False, ground=True)


def far(seed: int) -> Scene:
    """Build the demo on a field before hills 40 m away, which fill the view where the demo has its wall."""
    return _scene("far", seed, SKY, hills=True, ground=True)


def black(seed: int) -> Scene:
    """Build the demo's things and movers in front of nothing: no floor, no wall, no light from behind."""
    return _scene("black", seed, 0.0, hills=False, ground=False)


def _scene(name: str, seed: int, background: float, *, hills: bool, ground: bool) -> Scene:
    stage = Stage(np.random.default_rng([seed, 1]), textures.SIZE, 0.03)
    if hills:
        picture = stage.shape("rectangle", HILLS_M, Finish(PEBBLES, 0.12, (0.1, 0.6)))
        stage.bodies.append(still("hills", (0, FLOOR_Y_M - HILLS_M[1] + 2.0, FAR_M), picture))
    if ground:
        field = stage.shape("rectangle", (FIELD_M, FIELD_M), Finish(SPECKLE, 0.015, (0.15, 0.8)), STANDING)
        stage.bodies.append(still("field", (0, FLOOR_Y_M, 2.0), field))
    furnish(stage)
    stage.bodies += movers(stage)
    light = {"to_sun": (-0.42, -0.5, -0.75), "background": background}
    pictures = textures.build(np.random.default_rng([seed, 0]))
    return Scene(name, seed, tuple(stage.bodies), pictures, center=(0.0, 0.0, 1.8), mipmapped=True, **light)
