"""`plain`: a room without texture on its walls, on which depth of plain regions was developed."""

import math

import numpy as np

from acquisition.scenes.bodies import Finish, Shape, about, still
from acquisition.scenes.fan import fan_of
from acquisition.scenes.light import Uneven
from acquisition.scenes.scene import Scene
from acquisition.scenes.stage import CLOTH, Stage
from acquisition.scenes.stress import FLOOR_Y_M, NUMBER, crossing_ball
from rigs.transform import Transform

WALLS = (  # name, middle in m, turn, albedo
    ("back", (0.0, 0.0, 3.4), np.eye(3), 0.62),
    ("floor", (0.0, FLOOR_Y_M, 2.0), about(0, math.pi / 2), 0.4),
    ("ceiling", (0.0, -1.1, 2.0), about(0, math.pi / 2), 0.85),
    ("left", (-1.5, 0.0, 2.0), about(1, math.pi / 2), 0.55),
    ("right", (1.5, 0.0, 2.0), about(1, math.pi / 2), 0.7),
)


def plain(seed: int) -> Scene:
    """Build a room of painted walls with a poster, plain furniture and two textured movers."""
    stage = Stage.numbered(seed, NUMBER)
    for name, center, turned, albedo in WALLS:
        paint = Finish(CLOTH, 0.01, (albedo, albedo))
        stage.bodies.append(still(name, center, Shape("rectangle", (3.0, 3.0), paint, Transform(turned, np.zeros(3)))))
    stage.block("bed", stage.near(0.62, 0.46, 1.9), (0.25, 0.16, 0.3), Finish(CLOTH, 0.01, (0.8, 0.8)), 0.5)
    stage.block("chest", stage.near(-0.95, 0.2, 2.7), (0.25, 0.42, 0.2), Finish(CLOTH, 0.01, (0.45, 0.45)), -0.4)
    stage.marker((0.75, -0.42, 3.05), -0.15)
    turning = fan_of(stage, "propeller", (-0.1, -0.08, 1.75), (0.2, -0.1, 1.0), (4, 0.15, 0.1), 50.0)
    stage.bodies += turning, crossing_ball(stage, "ball", 0.14, (-0.5, 0.25, 1.9), 6.0, lane_m=4.0)
    light = {"to_sun": (-0.2, -0.12, -0.97), "uneven": Uneven((0.05, 0.03, -0.1), offset=1.2, least=0.3)}
    return stage.scene("plain", NUMBER, seed, **light)
