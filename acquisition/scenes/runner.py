"""`runner`: a jointed figure runs through a yard, for evaluation only."""

import math

from acquisition.scenes.bodies import Body, Finish, Shape, at
from acquisition.scenes.linkage import Hinge
from acquisition.scenes.motion import Motion, Movement, Vector
from acquisition.scenes.scene import Scene
from acquisition.scenes.stage import BLOCKS, CLOTH, DISCS, Stage
from rigs.transform import Transform

NUMBER = 12
GROUND_Y_M = 0.57
SPEED_M_S, LANE_M = 4.0, 6.0
STRIDE_RAD_S = 17.0  # 2.7 double steps a second
HIP_UP_M = 0.53
STEP_RAD = math.pi / 2 - 0.17  # the arm of the near side reaches furthest back after 10 ms
SHIRT, SKIN = Finish(DISCS, 0.0025, (0.12, 1.0)), Finish(CLOTH, 0.003, (0.15, 1.0))
SHORTS = Finish(BLOCKS, 0.0025, (0.01, 0.25))

Part = tuple[Shape, Movement]


def runner(seed: int) -> Scene:
    """Build a figure 1.1 m tall that runs at 4 m/s, its limbs at up to 8 m/s, past crates, a fence and a wall."""
    stage = Stage.numbered(seed, NUMBER)
    stage.room(GROUND_Y_M, Finish(DISCS, 0.008, (0.01, 0.6)), Finish(CLOTH, 0.006, (0.02, 0.6)))
    _yard(stage)
    stage.bodies.append(_figure(stage))
    stage.marker((0.85, -0.6, 2.7), -0.15)
    return stage.scene("runner", NUMBER, seed)


def _yard(stage: Stage) -> None:
    boards = Stage(stage.rng)  # drawn before the rail, listed behind it
    for n in range(6):
        boards.block(f"board{n}", (-1.45 + 0.3 * n, 0.2, 2.75), (0.06, 0.4, 0.015), Finish(CLOTH, 0.006, (0.05, 0.7)))
    stage.block("rail", (-0.7, 0.05, 2.78), (0.9, 0.04, 0.015), Finish(BLOCKS, 0.006, (0.05, 0.8)))
    stage.bodies += boards.bodies
    stage.block("crate", stage.near(0.62, 0.44, 1.4), (0.12, 0.16, 0.12), Finish(BLOCKS, 0.003, (0.02, 0.7)), 0.5)
    stage.pillar("barrel", stage.near(0.85, 0.28, 2.2), 0.19, 0.32, Finish(BLOCKS, 0.005, (0.03, 1.0)))
    stage.block("bin", stage.near(-0.85, 0.35, 1.9), (0.13, 0.25, 0.13), Finish(DISCS, 0.005, (0.03, 0.8)), -0.3)


def _figure(stage: Stage) -> Body:
    x, _, z = stage.near(-0.12, 0.0, 1.64)
    start, period_s = at(-LANE_M / 2, GROUND_Y_M - HIP_UP_M, z), LANE_M / SPEED_M_S
    hips = Motion(start, velocity_m_s=(SPEED_M_S, 0, 0), launch_s=-(x + LANE_M / 2) / SPEED_M_S, bounce_s=period_s)
    chest = Hinge(hips, at(0, -0.05, 0), rest_rad=0.18, swing_rad=0.05, rate_rad_s=2 * STRIDE_RAD_S)
    parts = [
        _box(stage, (0.075, 0.06, 0.09), (0, 0, 0), SHORTS, hips),
        _box(stage, (0.1, 0.17, 0.115), (0, -0.17, 0), SHIRT, chest),
        _box(stage, (0.03, 0.03, 0.03), (0.01, -0.36, 0), SKIN, chest),
        (stage.shape("sphere", (0.09,), SKIN, at(0.025, -0.46, 0)), chest),
    ]
    for aside, phase in ((-1, STEP_RAD), (1, STEP_RAD + math.pi)):  # the near side's, then the far side's
        parts += _arm(stage, chest, aside, phase) + _leg(stage, hips, aside, phase + math.pi)
    shapes, motions = zip(*parts, strict=True)
    return Body("runner", shapes, motions)


def _arm(stage: Stage, chest: Movement, aside: int, phase: float) -> list[Part]:
    upper = Hinge(chest, at(0, -0.29, aside * 0.15), swing_rad=0.85, rate_rad_s=STRIDE_RAD_S, phase_rad=phase)
    elbow = at(0, 0.22, 0)
    fore = Hinge(upper, elbow, rest_rad=-1.4, swing_rad=0.3, rate_rad_s=STRIDE_RAD_S, phase_rad=phase + 0.5)
    hand = stage.shape("sphere", (0.042,), SKIN, at(0, 0.22, 0))
    return [
        _box(stage, (0.042, 0.11, 0.045), (0, 0.11, 0), SHIRT, upper),
        _box(stage, (0.035, 0.1, 0.038), (0, 0.1, 0), SKIN, fore),
        (hand, fore),
    ]


def _leg(stage: Stage, hips: Movement, aside: int, phase: float) -> list[Part]:
    def swinging(parent: Movement, joint: Transform, rest: float, swing: float, lag: float) -> Hinge:
        return Hinge(parent, joint, (0, 0, 1), rest, swing, STRIDE_RAD_S, phase - lag)

    thigh = swinging(hips, at(0, 0.03, aside * 0.07), -0.3, 0.75, 0.0)
    shin = swinging(thigh, at(0, 0.26, 0), 0.85, 0.65, math.pi / 2)
    foot = swinging(shin, at(0, 0.25, 0), -0.1, 0.3, 0.5)
    return [
        _box(stage, (0.072, 0.14, 0.066), (0, 0.135, 0), SHORTS, thigh),
        _box(stage, (0.055, 0.13, 0.055), (0, 0.13, 0), SKIN, shin),
        _box(stage, (0.085, 0.03, 0.048), (0.05, 0.015, 0), SHIRT, foot),
    ]


def _box(stage: Stage, half: Vector, center: Vector, finish: Finish, motion: Movement) -> Part:
    return stage.shape("box", half, finish, at(*center)), motion
