"""`fan`: a large and a small fan turn in a workshop, for evaluation only."""

from acquisition.scenes.bodies import Body, Finish, Shape
from acquisition.scenes.motion import Vector
from acquisition.scenes.scene import Scene
from acquisition.scenes.stage import BLOCKS, CLOTH, DISCS, Rotor, Stage

NUMBER = 15
FLOOR_Y_M = 0.62
LARGE: Vector = (-0.22, -0.06, 1.75)
SMALL: Vector = (0.72, 0.1, 2.3)
BLADES = tuple(Finish(picture, 0.003, (0.1, 1.0)) for picture in (CLOTH, DISCS, BLOCKS))
HUB = Shape("cylinder", (0.07, 0.05), Finish(BLOCKS, 0.003, (0.02, 0.6)))


def fan(seed: int) -> Scene:
    """Build three broad blades at 60 rad/s and four short ones the other way at 120 rad/s, before shelves and tools."""
    stage = Stage.numbered(seed, NUMBER)
    stage.room(FLOOR_Y_M, Finish(DISCS, 0.008, (0.01, 0.6)), Finish(CLOTH, 0.006, (0.02, 0.6)))
    large = fan_of(stage, "large_fan", LARGE, (0.24, -0.08, 1.0), (3, 0.17, 0.13), 60.0)
    small = fan_of(stage, "small_fan", SMALL, (-0.3, -0.05, 1.0), (4, 0.11, 0.085), -120.0)
    x, y, z = LARGE
    stand_y, stand_half = (y + FLOOR_Y_M) / 2, (FLOOR_Y_M - y) / 2
    stage.pillar("stand", (x, stand_y, z + 0.14), 0.03, stand_half, Finish(CLOTH, 0.003, (0.1, 0.9)))
    stage.pillar("base", (x, FLOOR_Y_M - 0.02, z + 0.14), 0.2, 0.02, Finish(BLOCKS, 0.004, (0.02, 0.9)))
    stage.block("cabinet", stage.near(0.78, 0.44, 2.4), (0.3, 0.18, 0.2), Finish(DISCS, 0.005, (0.02, 0.8)))
    stage.block("crate", stage.near(0.58, 0.44, 1.4), (0.1, 0.16, 0.1), Finish(BLOCKS, 0.003, (0.03, 1.0)), 0.5)
    stage.block("rack", stage.near(-1.15, -0.1, 2.8), (0.3, 0.72, 0.2), Finish(BLOCKS, 0.007, (0.03, 1.0)), 0.3)
    stage.pillar("drum", stage.near(-0.15, 0.35, 2.9), 0.22, 0.27, Finish(CLOTH, 0.007, (0.03, 0.5)))
    stage.bodies += large, small
    stage.marker((0.6, -0.62, 2.75), -0.1)
    return stage.scene("fan", NUMBER, seed)


def fan_of(
    stage: Stage, name: str, center: Vector, faces: Vector, blades: tuple[int, float, float], spin_rad_s: float
) -> Body:
    """Return a fan of `blades` (their number, half length, half breadth in metres) that faces this direction."""
    count, half, breadth = blades
    finishes = [BLADES[blade % 3] for blade in range(count)]
    rotor = Rotor(finishes, (half, breadth, 0.006), half + 0.05, 0.42, HUB)
    return stage.propeller(name, center, faces, rotor, spin_rad_s)
