"""`traffic`: three vehicles pass one another on a street, for evaluation only."""

import math
from collections.abc import Sequence

from acquisition.scenes.bodies import UPRIGHT, Body, Finish, at, still
from acquisition.scenes.motion import Motion, Vector
from acquisition.scenes.scene import Scene
from acquisition.scenes.stage import BLOCKS, CLOTH, DISCS, Stage

NUMBER = 11
ROAD_Y_M = 0.56
LANE_M = 7.0  # a vehicle that has driven so far comes in again

Part = tuple[Vector, Vector, Finish]  # half sizes, middle above the road, finish
GLASS, LAMP = Finish(CLOTH, 0.004, (0.01, 0.15)), Finish(CLOTH, 0.004, (0.7, 1.0))
TYRE, HUB = Finish(BLOCKS, 0.0025, (0.01, 0.2)), Finish(BLOCKS, 0.002, (0.1, 1.0))
RED, WHITE, GREY = (Finish(picture, 0.004, (0.1, 1.0)) for picture in (CLOTH, DISCS, BLOCKS))
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
    """Build a saloon at 6 m/s, a van the other way at 4 and a lorry at 2.5 before a lamp post, a tree and houses."""
    stage = Stage.numbered(seed, NUMBER)
    stage.room(ROAD_Y_M, Finish(BLOCKS, 0.008, (0.01, 0.6)), Finish(DISCS, 0.006, (0.02, 0.6)))
    vehicles = (
        _vehicle(stage, "saloon", SALOON, (-0.3, 1.8), 6.0, axles=(-0.27, 0.28), radius=0.095),
        _vehicle(stage, "van", VAN, (0.5, 2.35), -4.0, axles=(-0.3, 0.32), radius=0.1),
        _vehicle(stage, "lorry", LORRY, (-0.8, 3.0), 2.5, axles=(-0.4, -0.17, 0.5), radius=0.11),
    )
    crown = stage.shape("sphere", (0.3,), Finish(DISCS, 0.006, (0.02, 0.6)), at(0.0, -0.75, 0.0))
    trunk = stage.shape("cylinder", (0.06, 0.5), Finish(CLOTH, 0.005, (0.02, 0.4)), UPRIGHT)
    stage.pillar("lamp_post", stage.near(-0.62, -0.3, 1.32), 0.035, 0.86, Finish(BLOCKS, 0.003, (0.05, 0.7)))
    stage.block("box", stage.near(0.64, 0.36, 1.36), (0.09, 0.2, 0.09), Finish(BLOCKS, 0.003, (0.03, 0.7)), 0.4)
    stage.bodies.append(still("tree", stage.near(1.2, ROAD_Y_M - 0.5, 3.15), trunk, crown))
    stage.block("house", stage.near(-1.25, -0.25, 3.3), (0.5, 0.82, 0.1), Finish(DISCS, 0.008, (0.02, 0.7)))
    stage.block("shop", stage.near(0.55, 0.05, 3.38), (0.4, 0.5, 0.06), Finish(CLOTH, 0.008, (0.05, 0.6)))
    stage.bodies += vehicles
    stage.marker((0.15, -0.62, 2.6), 0.1)
    return stage.scene("traffic", NUMBER, seed)


def _vehicle(
    stage: Stage,
    name: str,
    parts: Sequence[Part],
    place: tuple[float, float],
    speed_m_s: float,
    *,
    axles: Sequence[float],
    radius: float,
) -> Body:
    """Return boxes on rolling wheels, at `place` (x, z) at instant 0 of a lane that they drive again and again."""
    ahead = math.copysign(1.0, speed_m_s)
    x, _, z = stage.near(place[0], 0.0, place[1])

    def rolling(along: float, up: float, aside: float, spin_rad_s: float) -> Motion:
        start = at(ahead * (along - LANE_M / 2), ROAD_Y_M - up, z + aside)
        driven_s = (ahead * x + LANE_M / 2) / abs(speed_m_s)
        period_s = LANE_M / abs(speed_m_s)
        return Motion(start, (0, 0, 1), spin_rad_s, (speed_m_s, 0, 0), launch_s=-driven_s, bounce_s=period_s)

    chassis = rolling(0.0, 0.0, 0.0, 0.0)
    moved = [
        (stage.shape("box", half, finish, at(ahead * along, -up, aside)), chassis)
        for half, (along, up, aside), finish in parts
    ]
    for along in axles:
        for aside in (-0.15, 0.15):
            wheel = stage.shape("cylinder", (radius, 0.035), TYRE)
            moved.append((wheel, rolling(along, radius, aside, speed_m_s / radius)))
        hub = stage.shape("cylinder", (radius / 2, 0.04), HUB)  # on the side the cameras see
        moved.append((hub, rolling(along, radius, -0.15, speed_m_s / radius)))
    shapes, motions = zip(*moved, strict=True)
    return Body(name, shapes, motions)
