"""`pushed_blocks`: a pusher from the right leaves blocks on the ground while six things pass. For evaluation only."""

from acquisition.scenes.bodies import Finish, Shape, at
from acquisition.scenes.long_stage import LongStage, Passer, cart
from acquisition.scenes.passing import Carrier, Lane
from acquisition.scenes.scene import Scene
from acquisition.scenes.stage import BLOCKS, CLOTH, DISCS, Stage

NUMBER = 34
GROUND_Y_M = 0.56
BLOCK_HALF_M = (0.12, 0.13, 0.1)
GROUND = ((-0.35, 1.5), (0.5, 1.5), (0.1, 2.65), (-0.9, 2.65))  # x and z of each block
PLACES = tuple((x, GROUND_Y_M - BLOCK_HALF_M[1], z) for x, z in GROUND)
FINE = tuple(Finish(picture, 0.003, (0.08, 1.0)) for picture in (DISCS, CLOTH, BLOCKS))
SHAFT_M, HEAD_M = 1.5, 0.015  # half length of the pusher's shaft and half thickness of its head


def pushed_blocks(seed: int) -> Scene:
    """Build a pusher that brings four blocks; a cabinet, a disc, a ball, a board, a trolley and a float pass."""
    stage = Stage.numbered(seed, NUMBER)
    stage.room(GROUND_Y_M, Finish(DISCS, 0.008, (0.03, 0.7)), Finish(CLOTH, 0.006, (0.03, 0.7)))
    stage.pillar("post", stage.near(0.72, 0.1, 1.3), 0.03, 0.5, Finish(CLOTH, 0.003, (0.05, 0.9)))
    stage.block("bench", stage.near(0.75, 0.4, 3.1), (0.5, 0.16, 0.14), Finish(BLOCKS, 0.006, (0.05, 0.8)), -0.1)
    stage.block("cupboard", stage.near(-1.3, 0.0, 3.2), (0.3, 0.56, 0.12), Finish(DISCS, 0.007, (0.05, 0.8)), 0.2)
    stage.block("beam", stage.near(0.2, -0.75, 3.2), (0.9, 0.06, 0.1), Finish(BLOCKS, 0.006, (0.05, 0.8)))
    stage.marker((0.0, -0.35, 3.3), -0.1)
    long = LongStage(stage, seed, NUMBER)
    blocks = [stage.shape("box", BLOCK_HALF_M, FINE[(n + 1) % 3]) for n in range(len(PLACES))]
    pusher = Carrier((-HEAD_M - BLOCK_HALF_M[0], 0.0, 0.0), (0.0, -0.03, 0.0), 0.25, from_right=True)
    long.boxes("pusher", _pusher(stage), pusher, PLACES, blocks)
    long.passers(_things(stage))
    return long.scene("pushed_blocks", to_sun=(-0.05, -0.88, -0.46))


def _pusher(stage: Stage) -> tuple[Shape, ...]:
    head = stage.shape("box", (HEAD_M, 0.11, 0.08), FINE[2])
    return head, stage.shape("box", (SHAFT_M, 0.02, 0.03), FINE[1], at(SHAFT_M, 0, 0))


def _things(stage: Stage) -> tuple[Passer, ...]:
    trolley = cart(stage, (0.4, 0.13, 0.09), (0.22, 0.15, 0.07), (FINE[2], FINE[1]))
    floats = (stage.shape("box", (0.34, 0.1, 0.16), FINE[0]), stage.shape("sphere", (0.16,), FINE[1], at(0, -0.16, 0)))
    return (
        ("cabinet", Lane(0.05, 2.08, 0.3, turns_rad=0.5), (stage.shape("box", (0.27, 0.5, 0.1), FINE[0]),)),
        ("board", Lane(-0.27, 1.66, 0.5, turns_rad=0.6), (stage.shape("box", (0.42, 0.2, 0.012), FINE[2]),)),
        ("ball", Lane(0.34, 1.72, 0.2, 0.0, 0.2, 0.2, 1.2), (stage.shape("sphere", (0.2,), FINE[1]),)),
        ("trolley", Lane(0.4, 1.9, 0.42), trolley),
        ("disc", Lane(0.2, 2.4, 0.35, rolls_m=0.34), (stage.shape("cylinder", (0.34, 0.05), FINE[2]),)),
        ("float", Lane(-0.4, 2.3, 0.55), floats),
    )
