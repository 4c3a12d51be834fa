"""`traffic`: three vehicles pass one another on a street, for evaluation only."""

import math
from collections.abc import Sequence

import numpy as np

from acquisition.scenes import stage
from acquisition.scenes.bodies import Body, Finish, Shape, still
from acquisition.scenes.motion import Motion
from acquisition.scenes.scene import Scene
from acquisition.scenes.stage import BLOCKS, CLOTH, DISCS, FINE_M, Look
from rigs.transform import Transform

NUMBER = 11
ROAD_Y_M = 0.56
LANE_M = 7.0  # a vehicle that has driven so far comes in again

Part = tuple[tuple[float, float, float], tuple[float, float, float], Look]  # half sizes, middle above the road, look
GLASS, LAMP = Look(CLOTH, FINE_M, 0.01, 0.15), Look(CLOTH, FINE_M, 0.7, 1.0)
TYRE, HUB = Look(BLOCKS, 0.0025, 0.01, 0.2), Look(BLOCKS, 0.002, 0.1, 1.0)

RED, WHITE, GREY = Look(CLOTH, FINE_M, 0.1, 1.0), Look(DISCS, FINE_M, 0.1, 1.0), Look(BLOCKS, FINE_M, 0.1, 1.0)
SALOON: tuple[Part, ...] = (
    ((0.43, 0.085, 0.17), (0.0, 0.19, 0.0), RED),
    ((0.23, 0.075, 0.15), (-0.04, 0.345, 0.0), RED),
    ((0.20, 0.05, 0.152), (-0.04, 0.35, 0.0), GLASS),
    ((0.012, 0.075, 0.153), (-0.04, 0.345, 0.0), RED),
    ((0.45, 0.025, 0.175), (0.0, 0.13, 0.0), GLASS),
    ((0.01, 0.025, 0.12), (0.435, 0.21, 0.0), LAMP),
)
VAN: tuple[Part, ...] = (
    ((0.36, 0.21, 0.2), (-0.12, 0.34, 0.0), WHITE),
    ((0.14, 0.15, 0.19), (0.38, 0.28, 0.0), WHITE),
    ((0.09, 0.06, 0.192), (0.4, 0.35, 0.0), GLASS),
    ((0.52, 0.02, 0.205), (0.0, 0.12, 0.0), GLASS),
)
LORRY: tuple[Part, ...] = (
    ((0.45, 0.2, 0.2), (-0.1, 0.37, 0.0), GREY),
    ((0.17, 0.22, 0.2), (0.55, 0.33, 0.0), RED),
    ((0.1, 0.08, 0.202), (0.59, 0.42, 0.0), GLASS),
    ((0.62, 0.02, 0.19), (0.08, 0.12, 0.0), GLASS),
)


def traffic(seed: int) -> Scene:
    """A saloon at 6 m/s, a van the other way at 4 and a lorry at 2.5 between lamp post, trees and house fronts."""
    rng = stage.placing(seed, NUMBER)
    houses = stage.room(rng, ROAD_Y_M, Look(BLOCKS, 0.008, 0.01, 0.6), Look(DISCS, 0.006, 0.02, 0.6))
    vehicles = (
        vehicle(rng, "saloon", SALOON, (-0.3, 1.8), 6.0, axles=(-0.27, 0.28), radius=0.095),
        vehicle(rng, "van", VAN, (0.5, 2.35), -4.0, axles=(-0.3, 0.32), radius=0.1),
        vehicle(rng, "lorry", LORRY, (-0.8, 3.0), 2.5, axles=(-0.4, -0.17, 0.5), radius=0.11),
    )
    bodies = (*houses, *_street(rng), *vehicles, stage.marker((0.15, -0.62, 2.6), 0.42, 0.1))
    return stage.staged("traffic", NUMBER, seed, bodies)


def vehicle(
    rng: np.random.Generator,
    name: str,
    parts: Sequence[Part],
    place: tuple[float, float],
    speed_m_s: float,
    *,
    axles: Sequence[float],
    radius: float,
) -> Body:
    """Boxes on rolling wheels, at (x, z) `place` at instant 0 on a lane that it drives along again and again."""
    ahead = math.copysign(1.0, speed_m_s)
    x, z = stage.nudged(rng, place[0], 0.0, place[1])[::2]

    def rolling(along: float, up: float, aside: float, spin_rad_s: float) -> Motion:
        start = Transform(np.eye(3), np.array([ahead * (along - LANE_M / 2), ROAD_Y_M - up, z + aside]))
        driven_s = (ahead * x + LANE_M / 2) / abs(speed_m_s)
        period_s = LANE_M / abs(speed_m_s)
        return Motion(start, (0, 0, 1), spin_rad_s, (speed_m_s, 0, 0), launch_s=-driven_s, bounce_s=period_s)

    shapes, motions = [], []
    chassis = rolling(0.0, 0.0, 0.0, 0.0)
    for half, (along, up, aside), look in parts:
        shapes.append(Shape("box", half, stage.finish(rng, look), stage.at(ahead * along, -up, aside)))
        motions.append(chassis)
    for along in axles:
        for aside in (-0.15, 0.15):
            shapes.append(Shape("cylinder", (radius, 0.035), stage.finish(rng, TYRE)))
            motions.append(rolling(along, radius, aside, speed_m_s / radius))
        shapes.append(Shape("cylinder", (radius / 2, 0.04), stage.finish(rng, HUB)))  # on the side the cameras see
        motions.append(rolling(along, radius, -0.15, speed_m_s / radius))
    return Body(name, tuple(shapes), tuple(motions))


def _street(rng: np.random.Generator) -> tuple[Body, ...]:
    def skin(picture: int, texel_m: float, low: float, high: float) -> Finish:
        return stage.finish(rng, Look(picture, texel_m, low, high))

    crown = Shape("sphere", (0.3,), skin(DISCS, 0.006, 0.02, 0.6), stage.at(0.0, -0.75, 0.0))
    trunk = Shape("cylinder", (0.06, 0.5), skin(CLOTH, 0.005, 0.02, 0.4), stage.UPRIGHT)
    return (
        stage.pillar("lamp_post", stage.nudged(rng, -0.62, -0.3, 1.32), 0.035, 0.86, skin(BLOCKS, 0.003, 0.05, 0.7)),
        stage.block("box", stage.nudged(rng, 0.64, 0.36, 1.36), (0.09, 0.2, 0.09), skin(BLOCKS, 0.003, 0.03, 0.7), 0.4),
        still("tree", stage.nudged(rng, 1.2, ROAD_Y_M - 0.5, 3.15), trunk, crown),
        stage.block("house", stage.nudged(rng, -1.25, -0.25, 3.3), (0.5, 0.82, 0.1), skin(DISCS, 0.008, 0.02, 0.7)),
        stage.block("shop", stage.nudged(rng, 0.55, 0.05, 3.38), (0.4, 0.5, 0.06), skin(CLOTH, 0.008, 0.05, 0.6)),
    )
