"""`collision`: balls and boxes are thrown and hit one another in the air, for evaluation only."""

import numpy as np

from acquisition.scenes import stage
from acquisition.scenes.bodies import Body, Finish, Shape
from acquisition.scenes.collision import Thrown, thrown
from acquisition.scenes.motion import Vector
from acquisition.scenes.scene import Scene
from acquisition.scenes.stage import BLOCKS, CLOTH, DISCS, Look

NUMBER = 14
FLOOR_Y_M = 0.62
CLIP_S = 0.25  # later everything has left the view
LOOKS = (Look(DISCS, 0.003, 0.1, 1.0), Look(BLOCKS, 0.003, 0.1, 1.0), Look(CLOTH, 0.003, 0.1, 1.0))

# Where each is at the instant it is thrown to be at, its velocity there, and that instant.
Aim = tuple[Vector, Vector, float]
BALLS: tuple[tuple[str, float, float, Aim], ...] = (  # name, radius, mass, aim
    ("left_ball", 0.13, 1.0, ((-0.46, -0.17, 1.55), (4.0, -0.5, 0.3), 0.006)),
    ("right_ball", 0.11, 1.0, ((-0.24, -0.12, 1.55), (-3.5, 0.4, 0.2), 0.006)),
    ("high_ball", 0.12, 1.0, ((0.12, -0.45, 2.1), (0.6, 4.5, -0.5), 0.011)),
    ("low_ball", 0.14, 1.5, ((0.17, -0.2, 2.05), (-0.4, -3.5, 0.3), 0.011)),
    ("driver", 0.1, 0.7, ((0.32, 0.22, 1.6), (5.5, 0.0, 0.0), 0.009)),
    ("lone_ball", 0.12, 1.0, ((-0.55, 0.3, 2.3), (3.0, -3.5, 0.0), 0.0)),
)
BOX = ("struck_box", (0.12, 0.12, 0.12), 1.2, ((0.55, 0.22, 1.6), (-2.4, 0.0, 0.0), 0.009))
TUMBLERS = (
    ("red_box", (0.13, 0.07, 0.1), ((-0.5, 0.28, 1.75), (3.2, -2.0, 0.0), 0.0), (0.3, 1.0, 0.5), 45.0),
    ("tall_box", (0.06, 0.16, 0.07), ((0.75, -0.3, 2.2), (-4.5, -1.0, 0.3), 0.0), (1.0, 0.2, 0.6), -50.0),
)


def collision(seed: int) -> Scene:
    """Six balls and three boxes in the air at 2 to 6 m/s; within 10 ms three pairs hit, elastic, closed form."""
    rng = stage.placing(seed, NUMBER)
    room = stage.room(rng, FLOOR_Y_M, Look(BLOCKS, 0.008, 0.01, 0.6), Look(DISCS, 0.006, 0.02, 0.6))
    bodies = (*room, *_court(rng), *_things(rng), stage.marker((0.62, -0.68, 2.75), 0.42, -0.1))
    return stage.staged("collision", NUMBER, seed, bodies)


def _things(rng: np.random.Generator) -> list[Body]:
    names, shapes, throws = [], [], []
    for number, (name, radius, mass, aim) in enumerate(BALLS):
        spin = tuple(rng.uniform(-1, 1, 3) + np.array([0, 0, 2]))
        throws.append(_aimed(aim, radius, mass, (spin, 15.0)))
        shapes.append(Shape("sphere", (radius,), stage.finish(rng, LOOKS[number % 3])))
        names.append(name)
    for name, half, mass, aim in (BOX,):
        throws.append(_aimed(aim, half[0], mass, ((0, 0, 1), 0.0)))
        shapes.append(Shape("box", half, stage.finish(rng, LOOKS[1])))
        names.append(name)
    for name, half, aim, axis, spin_rad_s in TUMBLERS:
        throws.append(_aimed(aim, 0.01, 1.0, (axis, spin_rad_s)))
        shapes.append(Shape("box", half, stage.finish(rng, LOOKS[0])))
        names.append(name)
    motions = thrown(throws, CLIP_S)
    return [Body(name, (shape,), motion) for name, shape, motion in zip(names, shapes, motions, strict=True)]


def _aimed(aim: Aim, radius: float, mass: float, spin: tuple[Vector, float]) -> Thrown:
    """At instant 0, what is at the aim at its instant but for gravity, which all of them fall by alike."""
    (x, y, z), (vx, vy, vz), instant_s = aim
    start = (x - vx * instant_s, y - vy * instant_s, z - vz * instant_s)
    return Thrown(start, (vx, vy, vz), radius, mass, spin[0], spin[1])


def _court(rng: np.random.Generator) -> tuple[Body, ...]:
    def skin(picture: int, texel_m: float, low: float, high: float) -> Finish:
        return stage.finish(rng, Look(picture, texel_m, low, high))

    return (
        stage.block("bench", stage.nudged(rng, 0.0, 0.5, 2.6), (0.7, 0.12, 0.15), skin(CLOTH, 0.006, 0.04, 0.6)),
        stage.block(
            "crate", stage.nudged(rng, -0.62, 0.48, 1.4), (0.11, 0.14, 0.11), skin(DISCS, 0.003, 0.03, 1.0), 0.5
        ),
        stage.pillar("post", stage.nudged(rng, 1.15, 0.0, 2.5), 0.09, 0.62, skin(BLOCKS, 0.006, 0.03, 1.0)),
        stage.block("case", stage.nudged(rng, -1.2, 0.1, 2.9), (0.25, 0.52, 0.2), skin(DISCS, 0.007, 0.02, 0.6), -0.3),
    )
