"""`rolling_and_sliding`: drums roll, panels slide, balls hop, and an arm puts boxes on stands. Development."""

from acquisition.scenes.bodies import Finish, Shape, at
from acquisition.scenes.long_stage import LongStage, Passer
from acquisition.scenes.passing import Carrier, Lane
from acquisition.scenes.scene import Scene
from acquisition.scenes.stage import BLOCKS, CLOTH, DISCS, Stage

NUMBER = 32
FLOOR_Y_M = 0.6
STAND_TOP_Y_M, STAND_HALF_M = 0.22, 0.13
BOX_HALF_M = (0.1, 0.15, 0.1)
STANDS = ((0.42, 1.38), (-0.4, 1.38), (0.0, 2.55))  # x and z of each
PLACES = tuple((x, STAND_TOP_Y_M - BOX_HALF_M[1], z) for x, z in STANDS)
FINE = tuple(Finish(picture, 0.003, (0.1, 1.0)) for picture in (CLOTH, DISCS, BLOCKS))
ARM_M, PALM_M = 1.4, 0.012  # half length of the arm, half thickness of its palm


def rolling_and_sliding(seed: int) -> Scene:
    """Build drums, panels, a crate and a ball at 8 to 18 m/s, and an arm from the right that brings three boxes."""
    stage = Stage.numbered(seed, NUMBER)
    stage.room(FLOOR_Y_M, Finish(CLOTH, 0.008, (0.03, 0.7)), Finish(DISCS, 0.006, (0.03, 0.7)))
    for n, (x, z) in enumerate(STANDS):
        half = (FLOOR_Y_M - STAND_TOP_Y_M) / 2
        middle = (x, STAND_TOP_Y_M + half, z)
        stage.block(f"stand{n}", middle, (STAND_HALF_M, half, 0.12), Finish(BLOCKS, 0.004, (0.04, 0.8)))
    stage.block("shelf", stage.near(-0.9, -0.45, 3.2), (0.5, 0.04, 0.12), Finish(BLOCKS, 0.006, (0.05, 0.8)))
    stage.block("chest", stage.near(-1.3, 0.3, 3.1), (0.3, 0.3, 0.15), Finish(CLOTH, 0.006, (0.05, 0.8)), 0.3)
    stage.pillar("column", stage.near(1.15, 0.0, 2.9), 0.11, 0.6, Finish(DISCS, 0.006, (0.04, 0.8)))
    stage.marker((0.45, -0.6, 3.2), -0.1)
    long = LongStage(stage, seed, NUMBER)
    boxes = [stage.shape("box", BOX_HALF_M, FINE[n]) for n in range(len(PLACES))]
    arm = Carrier((-PALM_M - BOX_HALF_M[0], 0.0, 0.0), (0.0, -0.06, 0.0), 0.2, from_right=True)
    long.boxes("arm", _arm(stage), arm, PLACES, boxes)
    long.passers(_things(stage))
    return long.scene("rolling_and_sliding", to_sun=(0.12, -0.86, -0.48))


def _arm(stage: Stage) -> tuple[Shape, ...]:
    palm = stage.shape("box", (PALM_M, 0.1, 0.09), FINE[0])
    return palm, stage.shape("box", (ARM_M, 0.025, 0.025), FINE[2], at(ARM_M, 0, 0))


def _things(stage: Stage) -> tuple[Passer, ...]:
    return (
        ("near_drum", Lane(0.33, 1.62, 0.27, rolls_m=0.27), (stage.shape("cylinder", (0.27, 0.1), FINE[1]),)),
        ("tall_panel", Lane(0.12, 2.1, 0.36, turns_rad=0.5), (stage.shape("box", (0.36, 0.46, 0.015), FINE[2]),)),
        ("ball", Lane(0.42, 1.88, 0.17, 0.0, 0.17, 0.45, 1.0), (stage.shape("sphere", (0.17,), FINE[0]),)),
        ("far_drum", Lane(0.3, 2.32, 0.3, rolls_m=0.3), (stage.shape("cylinder", (0.3, 0.1), FINE[0]),)),
        ("crate", Lane(0.32, 1.5, 0.2, turns_rad=0.8), (stage.shape("box", (0.2, 0.15, 0.08), FINE[2]),)),
        ("sign", Lane(-0.28, 1.72, 0.55, turns_rad=0.7), (stage.shape("box", (0.45, 0.19, 0.015), FINE[1]),)),
    )
