"""`hoisted_barrels`: a hoist puts barrels on a platform while six things pass. For evaluation only."""

from acquisition.scenes.bodies import UPRIGHT, Finish, at
from acquisition.scenes.long_stage import LongStage, Passer, cart
from acquisition.scenes.passing import Carrier, Lane
from acquisition.scenes.scene import Scene
from acquisition.scenes.stage import BLOCKS, CLOTH, DISCS, Stage

NUMBER = 33
GROUND_Y_M = 0.6
PLATFORM_Y_M, PLATFORM_Z_M = 0.14, 2.5
RADIUS_M, HALF_M = 0.12, 0.16
PLACES = tuple((x, PLATFORM_Y_M - HALF_M, PLATFORM_Z_M) for x in (-0.4, 0.55, -0.9, 0.1))
FINE = tuple(Finish(picture, 0.003, (0.08, 1.0)) for picture in (BLOCKS, CLOTH, DISCS))
BAR_M, CABLE_M = 0.02, 1.1  # half height of the hoist's bar and half length of its cables


def hoisted_barrels(seed: int) -> Scene:
    """Build a hoist that brings four barrels; a sledge, a wheel, a boulder, a case, a beam and a plate pass."""
    stage = Stage.numbered(seed, NUMBER)
    stage.room(GROUND_Y_M, Finish(BLOCKS, 0.008, (0.03, 0.7)), Finish(CLOTH, 0.006, (0.03, 0.7)))
    platform = (1.25, (GROUND_Y_M - PLATFORM_Y_M) / 2, 0.16)
    middle = (0.0, (GROUND_Y_M + PLATFORM_Y_M) / 2, PLATFORM_Z_M)
    stage.block("platform", middle, platform, Finish(DISCS, 0.005, (0.05, 0.8)))
    stage.block("bollard", stage.near(0.7, 0.38, 1.36), (0.06, 0.22, 0.06), Finish(BLOCKS, 0.003, (0.05, 0.9)), 0.5)
    stage.pillar("mast", stage.near(-1.35, -0.1, 3.1), 0.1, 0.7, Finish(DISCS, 0.006, (0.05, 0.8)))
    stage.block("hut", stage.near(1.1, 0.2, 3.25), (0.3, 0.4, 0.1), Finish(CLOTH, 0.007, (0.05, 0.8)), 0.15)
    stage.marker((-0.3, -0.6, 3.2), 0.1)
    long = LongStage(stage, seed, NUMBER)
    barrels = [stage.shape("cylinder", (RADIUS_M, HALF_M), FINE[n % 3], UPRIGHT) for n in range(len(PLACES))]
    bar = stage.shape("box", (0.17, BAR_M, 0.06), FINE[2])
    cables = [stage.shape("box", (0.012, CABLE_M, 0.012), FINE[0], at(x, -CABLE_M, 0)) for x in (-0.14, 0.14)]
    hoist = Carrier((0.0, BAR_M + HALF_M, 0.0), (0.0, -0.26, 0.0), 0.55)
    long.boxes("hoist", (bar, *cables), hoist, PLACES, barrels)
    long.passers(_things(stage))
    return long.scene("hoisted_barrels", to_sun=(0.08, -0.86, -0.5))


def _things(stage: Stage) -> tuple[Passer, ...]:
    sledge = cart(stage, (0.46, 0.12, 0.1), (0.25, 0.12, 0.08), (FINE[1], FINE[0]))
    return (
        ("sledge", Lane(0.4, 1.74, 0.46), sledge),
        ("plate", Lane(-0.3, 2.9, 0.5, turns_rad=0.45), (stage.shape("box", (0.45, 0.32, 0.012), FINE[2]),)),
        ("boulder", Lane(0.4, 1.54, 0.2, 0.0, 0.19, 0.3, 1.3), (stage.shape("sphere", (0.19,), FINE[1]),)),
        ("wheel", Lane(0.27, 1.97, 0.33, rolls_m=0.33), (stage.shape("cylinder", (0.33, 0.06), FINE[0]),)),
        ("beam", Lane(-0.36, 1.7, 0.66, turns_rad=0.25), (stage.shape("box", (0.55, 0.12, 0.05), FINE[2]),)),
        ("case", Lane(0.27, 2.2, 0.42, turns_rad=0.3), (stage.shape("box", (0.38, 0.32, 0.08), FINE[0]),)),
    )
