"""`turntable`: a still life turns on a plate, for evaluation only."""

import numpy as np

from acquisition.scenes import stage
from acquisition.scenes.bodies import Body, Finish, Shape
from acquisition.scenes.motion import Motion
from acquisition.scenes.scene import Scene
from acquisition.scenes.stage import BLOCKS, CLOTH, DISCS, Look
from rigs.transform import Transform

NUMBER = 13
FLOOR_Y_M = 0.66
PLATE_Y_M = 0.36
SPIN_RAD_S = 42.0


def turntable(seed: int) -> Scene:
    """A jug, a book, a ball, a column and a cube turn at 42 rad/s; their rims run at up to 19 m/s."""
    rng = stage.placing(seed, NUMBER)
    room = stage.room(rng, FLOOR_Y_M, Look(CLOTH, 0.008, 0.01, 0.6), Look(BLOCKS, 0.006, 0.02, 0.6))
    bodies = (*room, *_study(rng), _plate(rng), stage.marker((-0.75, -0.55, 2.65), 0.42, 0.15))
    return stage.staged("turntable", NUMBER, seed, bodies)


def _plate(rng: np.random.Generator) -> Body:
    def skin(picture: int, low: float, high: float) -> Finish:
        return stage.finish(rng, Look(picture, 0.0035, low, high))

    upright = stage.UPRIGHT.rotation
    shapes = (
        Shape("cylinder", (0.46, 0.025), skin(BLOCKS, 0.03, 0.9), stage.at(0, 0.025, 0, upright)),
        Shape("cylinder", (0.1, 0.13), skin(CLOTH, 0.1, 1.0), stage.at(-0.26, -0.13, -0.1, upright)),
        Shape("sphere", (0.105,), skin(CLOTH, 0.1, 1.0), stage.at(-0.26, -0.3, -0.1)),
        Shape("cylinder", (0.045, 0.07), skin(CLOTH, 0.1, 1.0), stage.at(-0.26, -0.42, -0.1, upright)),
        Shape("box", (0.035, 0.19, 0.14), skin(DISCS, 0.03, 1.0), stage.at(0.14, -0.19, 0.22, stage.about(1, 0.5))),
        Shape("sphere", (0.12,), skin(BLOCKS, 0.02, 1.0), stage.at(0.24, -0.12, -0.14)),
        Shape("box", (0.08, 0.3, 0.08), skin(DISCS, 0.02, 0.5), stage.at(0.02, -0.3, 0.02, stage.about(1, 0.8))),
        Shape("box", (0.09, 0.09, 0.09), skin(BLOCKS, 0.02, 1.0), stage.at(-0.08, -0.09, 0.3, stage.about(1, 0.3))),
    )
    middle = Transform(np.eye(3), np.array(stage.nudged(rng, 0.02, PLATE_Y_M, 1.85)))
    return Body("plate", shapes, Motion(middle, (0, 1, 0), SPIN_RAD_S))


def _study(rng: np.random.Generator) -> tuple[Body, ...]:
    def skin(picture: int, texel_m: float, low: float, high: float) -> Finish:
        return stage.finish(rng, Look(picture, texel_m, low, high))

    return (
        stage.pillar("foot", (0.02, 0.53, 1.85), 0.16, 0.11, skin(DISCS, 0.004, 0.03, 0.7)),
        stage.block("desk", stage.nudged(rng, 1.0, 0.33, 2.55), (0.35, 0.33, 0.2), skin(DISCS, 0.006, 0.02, 0.6), -0.2),
        stage.block(
            "screen", stage.nudged(rng, 1.0, -0.22, 2.6), (0.27, 0.2, 0.03), skin(CLOTH, 0.006, 0.05, 0.7), -0.3
        ),
        stage.block(
            "stool", stage.nudged(rng, -0.62, 0.5, 1.36), (0.1, 0.16, 0.1), skin(BLOCKS, 0.003, 0.03, 0.9), 0.3
        ),
        stage.pillar("lamp", stage.nudged(rng, -1.05, 0.0, 2.3), 0.05, 0.66, skin(BLOCKS, 0.005, 0.03, 0.8)),
        stage.block("shelf", stage.nudged(rng, 0.3, -0.75, 3.2), (0.6, 0.05, 0.15), skin(BLOCKS, 0.008, 0.02, 0.7)),
    )
