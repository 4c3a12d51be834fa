"""`runner`: a jointed figure runs through a yard, for evaluation only."""

import math

import numpy as np

from acquisition.scenes import stage
from acquisition.scenes.bodies import Body, Finish, Shape
from acquisition.scenes.linkage import Hinge
from acquisition.scenes.motion import Motion, Movement
from acquisition.scenes.scene import Scene
from acquisition.scenes.stage import BLOCKS, CLOTH, DISCS, Look
from rigs.transform import Transform

NUMBER = 12
GROUND_Y_M = 0.57
SPEED_M_S, LANE_M = 4.0, 6.0
STRIDE_RAD_S = 17.0  # 2.7 double steps a second
HIP_UP_M = 0.53
STEP_RAD = math.pi / 2 - 0.17  # the arm of the near side reaches furthest back after 10 ms
SHIRT, SKIN, SHORTS = Look(DISCS, 0.0025, 0.12, 1.0), Look(CLOTH, 0.003, 0.15, 1.0), Look(BLOCKS, 0.0025, 0.01, 0.25)


def runner(seed: int) -> Scene:
    """A figure 1.1 m tall runs at 4 m/s, its limbs at up to 8 m/s, past crates, a fence and a wall."""
    rng = stage.placing(seed, NUMBER)
    yard = stage.room(rng, GROUND_Y_M, Look(DISCS, 0.008, 0.01, 0.6), Look(CLOTH, 0.006, 0.02, 0.6))
    bodies = (*yard, *_yard(rng), _figure(rng), stage.marker((0.85, -0.6, 2.7), 0.42, -0.15))
    return stage.staged("runner", NUMBER, seed, bodies)


def _figure(rng: np.random.Generator) -> Body:
    x, z = stage.nudged(rng, -0.12, 0.0, 1.64)[::2]
    start = Transform(np.eye(3), np.array([-LANE_M / 2, GROUND_Y_M - HIP_UP_M, z]))
    period_s = LANE_M / SPEED_M_S
    hips = Motion(start, velocity_m_s=(SPEED_M_S, 0, 0), launch_s=-(x + LANE_M / 2) / SPEED_M_S, bounce_s=period_s)
    chest = Hinge(hips, stage.at(0, -0.05, 0), rest_rad=0.18, swing_rad=0.05, rate_rad_s=2 * STRIDE_RAD_S)
    parts = [
        (_box(rng, (0.075, 0.06, 0.09), (0, 0, 0), SHORTS), hips),
        (_box(rng, (0.1, 0.17, 0.115), (0, -0.17, 0), SHIRT), chest),
        (_box(rng, (0.03, 0.03, 0.03), (0.01, -0.36, 0), SKIN), chest),
        (Shape("sphere", (0.09,), stage.finish(rng, SKIN), stage.at(0.025, -0.46, 0)), chest),
    ]
    for aside, phase in ((-1, STEP_RAD), (1, STEP_RAD + math.pi)):  # the near side's, then the far side's
        parts += _arm(rng, chest, aside, phase) + _leg(rng, hips, aside, phase + math.pi)
    shapes, motions = zip(*parts, strict=True)
    return Body("runner", tuple(shapes), tuple(motions))


def _arm(rng: np.random.Generator, chest: Movement, aside: int, phase: float) -> list[tuple[Shape, Movement]]:
    upper = Hinge(chest, stage.at(0, -0.29, aside * 0.15), swing_rad=0.85, rate_rad_s=STRIDE_RAD_S, phase_rad=phase)
    joint = stage.at(0, 0.22, 0)
    fore = Hinge(upper, joint, rest_rad=-1.4, swing_rad=0.3, rate_rad_s=STRIDE_RAD_S, phase_rad=phase + 0.5)
    hand = Shape("sphere", (0.042,), stage.finish(rng, SKIN), stage.at(0, 0.22, 0))
    return [
        (_box(rng, (0.042, 0.11, 0.045), (0, 0.11, 0), SHIRT), upper),
        (_box(rng, (0.035, 0.1, 0.038), (0, 0.1, 0), SKIN), fore),
        (hand, fore),
    ]


def _leg(rng: np.random.Generator, hips: Movement, aside: int, phase: float) -> list[tuple[Shape, Movement]]:
    def swinging(parent: Movement, joint: Transform, rest: float, swing: float, lag: float) -> Hinge:
        return Hinge(parent, joint, (0, 0, 1), rest, swing, STRIDE_RAD_S, phase - lag)

    thigh = swinging(hips, stage.at(0, 0.03, aside * 0.07), -0.3, 0.75, 0.0)
    shin = swinging(thigh, stage.at(0, 0.26, 0), 0.85, 0.65, math.pi / 2)
    foot = swinging(shin, stage.at(0, 0.25, 0), -0.1, 0.3, 0.5)
    return [
        (_box(rng, (0.072, 0.14, 0.066), (0, 0.135, 0), SHORTS), thigh),
        (_box(rng, (0.055, 0.13, 0.055), (0, 0.13, 0), SKIN), shin),
        (_box(rng, (0.085, 0.03, 0.048), (0.05, 0.015, 0), SHIRT), foot),
    ]


def _box(
    rng: np.random.Generator, half: tuple[float, float, float], center: tuple[float, float, float], look: Look
) -> Shape:
    return Shape("box", half, stage.finish(rng, look), stage.at(*center))


def _yard(rng: np.random.Generator) -> tuple[Body, ...]:
    def skin(picture: int, texel_m: float, low: float, high: float) -> Finish:
        return stage.finish(rng, Look(picture, texel_m, low, high))

    boards = [
        stage.block(f"board{n}", (-1.45 + 0.3 * n, 0.2, 2.75), (0.06, 0.4, 0.015), skin(CLOTH, 0.006, 0.05, 0.7))
        for n in range(6)
    ]
    return (
        stage.block("rail", (-0.7, 0.05, 2.78), (0.9, 0.04, 0.015), skin(BLOCKS, 0.006, 0.05, 0.8)),
        *boards,
        stage.block(
            "crate", stage.nudged(rng, 0.62, 0.44, 1.4), (0.12, 0.16, 0.12), skin(BLOCKS, 0.003, 0.02, 0.7), 0.5
        ),
        stage.pillar("barrel", stage.nudged(rng, 0.85, 0.28, 2.2), 0.19, 0.32, skin(BLOCKS, 0.005, 0.03, 1.0)),
        stage.block(
            "bin", stage.nudged(rng, -0.85, 0.35, 1.9), (0.13, 0.25, 0.13), skin(DISCS, 0.005, 0.03, 0.8), -0.3
        ),
    )
