"""Draws random scenes and rigs around them, to train networks of several views on.

The scenes are those of `clutter`, made as wide as a rig's field, with textures as fine as its pixels and often a floor.
The rigs vary the lab rig's grid: spacing, distance, lens, which of its places are taken, and what cameras have of their
own.
"""

import math
from dataclasses import replace

import numpy as np

from acquisition.errors import AcquisitionError
from acquisition.scenes import natural
from acquisition.scenes.bodies import UPRIGHT, Body, Finish, Shape, still
from acquisition.scenes.motion import Motion
from acquisition.scenes.own import Own, owned
from acquisition.scenes.random.clutter import FOCAL_PX, random_scene
from acquisition.scenes.random.photographs import crops
from acquisition.scenes.scene import Scene
from rigs.camera import Camera
from rigs.rig import Rig
from rigs.transform import Transform

LAB_WIDTH_PX = 400  # width of the picture that FOCAL_PX belongs to
FIELD_PX = 300  # width of the part of the lab camera's picture that the bodies are spread over
PLACES = tuple((row, column) for row in range(-1, 2) for column in range(-1, 2))
SPACING_M, DISTANCE_M, LENS = (0.12, 0.28), (1.4, 2.4), (0.75, 1.4)  # lens: focal length over the lab rig's
ASIDE = 0.02  # standard deviation of the principal points from the middle, as a share of the width
GAINS, LAGS = 0.08, 0.5  # standard deviation of the cameras' gains; most ticks that one sees early or late
FLOOR_SHARE, STILL_SHARE, NATURAL_SHARE = 0.6, 0.85, 0.5
FLOOR_Y_M = (0.4, 0.8)


def random_rig(seed: int, views: int, width: int, height: int, tick_rate_hz: float = 20000.0) -> Rig:
    """Draw rig number `seed`: `views` cameras on different places of a 3x3 grid, turned about towards one point.

    Its poses are the true ones; `misplaced` makes nominal ones of them. Raises AcquisitionError for less than 2 or more
    than 9 views.
    """
    if not 2 <= views <= len(PLACES):
        raise AcquisitionError(f"found a rig of {views} views", f"2 to {len(PLACES)}")
    rng = np.random.default_rng([seed, 0x61])
    spacing, distance = rng.uniform(*SPACING_M), rng.uniform(*DISTANCE_M)
    focal = FOCAL_PX * width / LAB_WIDTH_PX * rng.uniform(*LENS)
    aside = np.random.default_rng([seed, 0x63]).normal(0, ASIDE * width, (views, 2))
    cameras = []
    for (x, y), place in zip(aside, sorted(rng.choice(len(PLACES), views, replace=False)), strict=True):
        row, column = PLACES[place]
        center = spacing * np.array([column, row, 0]) + rng.normal(0, 0.03, 3)
        aim = np.array([0, 0, distance]) + rng.normal(0, 0.06, 3)
        roll = Transform.from_rotvec((0, 0, rng.normal(0, 0.03)))
        pose = roll @ Transform.looking_at(center, aim)
        name = f"cam{row + 1}{column + 1}"
        cameras.append(Camera(name, width, height, focal, focal, width / 2 + x, height / 2 + y, pose))
    return Rig(f"random{seed}", tick_rate_hz, tuple(cameras), "calibrated")


def random_own(seed: int, views: int) -> list[Own]:
    """Draw the gain and the lag of each camera of rig number `seed`."""
    return owned(views, GAINS, LAGS, seed)


def multiview_scene(seed: int, focal_px: float, middle_s: float = 0.0, *, photographed: bool = False) -> Scene:
    """Build scene number `seed` for cameras of focal length `focal_px`, its movers in their places at `middle_s`.

    Its textures are drawn, or `photographed`; raises MissingRendererError then where no photographs are installed.
    """
    scene = random_scene(seed, middle_s, FIELD_PX)
    rng = np.random.default_rng([seed, 0x62])
    pictures = scene.textures
    if photographed:
        pictures = crops(rng, len(pictures), natural.SIZE)
    elif rng.random() < NATURAL_SHARE:
        leaves = natural.leaves(rng, square=bool(rng.integers(2)))
        pictures = np.concatenate([np.tile(pictures, (1, 2, 2)), np.stack([leaves, natural.cloth(rng)])])
    holds = rng.random() < STILL_SHARE
    bodies = [_seen(rng, body, FOCAL_PX / focal_px, len(pictures), holds) for body in scene.bodies]
    if rng.random() < FLOOR_SHARE:
        bodies.append(_floor(rng, focal_px, len(pictures)))
    return replace(scene, name="multiview", bodies=tuple(bodies), textures=pictures, mipmapped=True)


def _seen(rng: np.random.Generator, body: Body, coarser: float, pictures: int, holds: bool) -> Body:
    """Return the body with coarser texels of any of the pictures; it stands where it `holds`."""
    shapes = []
    for shape in body.shapes:
        finish = replace(shape.finish, texel_m=shape.finish.texel_m * coarser, texture=int(rng.integers(pictures)))
        shapes.append(replace(shape, finish=finish))
    motion = body.motion
    if holds and isinstance(motion, Motion):
        motion = Motion(motion.start)
    return replace(body, shapes=tuple(shapes), motion=motion)


def _floor(rng: np.random.Generator, focal_px: float, pictures: int) -> Body:
    low = rng.uniform(0.02, 0.4)
    texel_m = math.exp(rng.uniform(math.log(0.7), math.log(4.0))) * 1.8 / focal_px
    shift = (float(rng.uniform(0, 256)), float(rng.uniform(0, 256)))
    finish = Finish(int(rng.integers(pictures)), texel_m, (low, rng.uniform(low + 0.1, 1.0)), shift)
    ground = Shape("rectangle", (4.0, 4.0), finish, UPRIGHT)
    return still("floor", (0.0, float(rng.uniform(*FLOOR_Y_M)), 2.0), ground)
