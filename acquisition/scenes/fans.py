"""`fan`: a large and a small fan turn in a workshop, for evaluation only."""

import math

import numpy as np

from acquisition.scenes import stage
from acquisition.scenes.bodies import Body, Finish, Shape
from acquisition.scenes.motion import Motion, Vector
from acquisition.scenes.scene import Scene
from acquisition.scenes.stage import BLOCKS, CLOTH, DISCS, Look
from rigs.transform import Transform

NUMBER = 15
FLOOR_Y_M = 0.62
LARGE: Vector = (-0.22, -0.06, 1.75)
SMALL: Vector = (0.72, 0.1, 2.3)


def fan(seed: int) -> Scene:
    """Three broad blades at 60 rad/s, four short ones the other way at 120 rad/s, before shelves and tools."""
    rng = stage.placing(seed, NUMBER)
    room = stage.room(rng, FLOOR_Y_M, Look(DISCS, 0.008, 0.01, 0.6), Look(CLOTH, 0.006, 0.02, 0.6))
    fans = (
        propeller(rng, "large_fan", LARGE, (0.24, -0.08, 1.0), (3, 0.17, 0.13), 60.0),
        propeller(rng, "small_fan", SMALL, (-0.3, -0.05, 1.0), (4, 0.11, 0.085), -120.0),
    )
    bodies = (*room, *_workshop(rng), *fans, stage.marker((0.6, -0.62, 2.75), 0.42, -0.1))
    return stage.staged("fan", NUMBER, seed, bodies)


def propeller(
    rng: np.random.Generator,
    name: str,
    center: Vector,
    faces: Vector,
    blades: tuple[int, float, float],
    spin_rad_s: float,
) -> Body:
    """`blades` (their number, half length, half breadth) pitched around a hub whose axis points along `faces`."""
    number, half, breadth = blades
    looks = (Look(CLOTH, 0.003, 0.1, 1.0), Look(DISCS, 0.003, 0.1, 1.0), Look(BLOCKS, 0.003, 0.1, 1.0))
    shapes = []
    for blade in range(number):
        around = stage.about(2, 2 * math.pi * blade / number)
        out = around @ np.array([half + 0.05, 0, 0])
        skin = stage.finish(rng, looks[blade % 3])
        shapes.append(Shape("box", (half, breadth, 0.006), skin, Transform(around @ stage.about(0, 0.42), out)))
    shapes.append(Shape("cylinder", (0.07, 0.05), stage.finish(rng, Look(BLOCKS, 0.003, 0.02, 0.6))))
    aim = Transform.looking_at((0, 0, 0), faces)
    start = Transform(aim.rotation.T, np.array(stage.nudged(rng, *center)))
    axis = aim.rotation[2]
    return Body(name, tuple(shapes), Motion(start, (axis[0], axis[1], axis[2]), spin_rad_s))


def _workshop(rng: np.random.Generator) -> tuple[Body, ...]:
    def skin(picture: int, texel_m: float, low: float, high: float) -> Finish:
        return stage.finish(rng, Look(picture, texel_m, low, high))

    x, y, z = LARGE
    return (
        stage.pillar(
            "stand", (x, (y + FLOOR_Y_M) / 2, z + 0.14), 0.03, (FLOOR_Y_M - y) / 2, skin(CLOTH, 0.003, 0.1, 0.9)
        ),
        stage.pillar("base", (x, FLOOR_Y_M - 0.02, z + 0.14), 0.2, 0.02, skin(BLOCKS, 0.004, 0.02, 0.9)),
        stage.block("cabinet", stage.nudged(rng, 0.78, 0.44, 2.4), (0.3, 0.18, 0.2), skin(DISCS, 0.005, 0.02, 0.8)),
        stage.block("crate", stage.nudged(rng, 0.58, 0.44, 1.4), (0.1, 0.16, 0.1), skin(BLOCKS, 0.003, 0.03, 1.0), 0.5),
        stage.block("rack", stage.nudged(rng, -1.15, -0.1, 2.8), (0.3, 0.72, 0.2), skin(BLOCKS, 0.007, 0.03, 1.0), 0.3),
        stage.pillar("drum", stage.nudged(rng, -0.15, 0.35, 2.9), 0.22, 0.27, skin(CLOTH, 0.007, 0.03, 0.5)),
    )
