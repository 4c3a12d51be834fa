"""`turntable`: a still life turns on a plate, for evaluation only."""

from acquisition.scenes.bodies import UPRIGHT, Body, Finish, about, at
from acquisition.scenes.motion import Motion
from acquisition.scenes.scene import Scene
from acquisition.scenes.stage import BLOCKS, CLOTH, DISCS, Stage

NUMBER = 13
FLOOR_Y_M = 0.66
PLATE_Y_M = 0.36
SPIN_RAD_S = 42.0


def turntable(seed: int) -> Scene:
    """Build a jug, a book, a ball, a column and a cube that turn at 42 rad/s; their rims run at up to 19 m/s."""
    stage = Stage.numbered(seed, NUMBER)
    stage.room(FLOOR_Y_M, Finish(CLOTH, 0.008, (0.01, 0.6)), Finish(BLOCKS, 0.006, (0.02, 0.6)))
    stage.pillar("foot", (0.02, 0.53, 1.85), 0.16, 0.11, Finish(DISCS, 0.004, (0.03, 0.7)))
    stage.block("desk", stage.near(1.0, 0.33, 2.55), (0.35, 0.33, 0.2), Finish(DISCS, 0.006, (0.02, 0.6)), -0.2)
    stage.block("screen", stage.near(1.0, -0.22, 2.6), (0.27, 0.2, 0.03), Finish(CLOTH, 0.006, (0.05, 0.7)), -0.3)
    stage.block("stool", stage.near(-0.62, 0.5, 1.36), (0.1, 0.16, 0.1), Finish(BLOCKS, 0.003, (0.03, 0.9)), 0.3)
    stage.pillar("lamp", stage.near(-1.05, 0.0, 2.3), 0.05, 0.66, Finish(BLOCKS, 0.005, (0.03, 0.8)))
    stage.block("shelf", stage.near(0.3, -0.75, 3.2), (0.6, 0.05, 0.15), Finish(BLOCKS, 0.008, (0.02, 0.7)))
    stage.bodies.append(_plate(stage))
    stage.marker((-0.75, -0.55, 2.65), 0.15)
    return stage.scene("turntable", NUMBER, seed)


def _plate(stage: Stage) -> Body:
    clay, stone = Finish(CLOTH, 0.0035, (0.1, 1.0)), Finish(BLOCKS, 0.0035, (0.02, 1.0))
    book, column = Finish(DISCS, 0.0035, (0.03, 1.0)), Finish(DISCS, 0.0035, (0.02, 0.5))
    upright = UPRIGHT.rotation
    shapes = (
        stage.shape("cylinder", (0.46, 0.025), Finish(BLOCKS, 0.0035, (0.03, 0.9)), at(0, 0.025, 0, upright)),
        stage.shape("cylinder", (0.1, 0.13), clay, at(-0.26, -0.13, -0.1, upright)),
        stage.shape("sphere", (0.105,), clay, at(-0.26, -0.3, -0.1)),
        stage.shape("cylinder", (0.045, 0.07), clay, at(-0.26, -0.42, -0.1, upright)),
        stage.shape("box", (0.035, 0.19, 0.14), book, at(0.14, -0.19, 0.22, about(1, 0.5))),
        stage.shape("sphere", (0.12,), stone, at(0.24, -0.12, -0.14)),
        stage.shape("box", (0.08, 0.3, 0.08), column, at(0.02, -0.3, 0.02, about(1, 0.8))),
        stage.shape("box", (0.09, 0.09, 0.09), stone, at(-0.08, -0.09, 0.3, about(1, 0.3))),
    )
    return Body("plate", shapes, Motion(at(*stage.near(0.02, PLATE_Y_M, 1.85)), (0, 1, 0), SPIN_RAD_S))
