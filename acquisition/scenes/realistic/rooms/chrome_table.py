"""`chrome_table`: metal balls roll over a lacquered table between photographs that they mirror."""

from __future__ import annotations

import numpy as np

from acquisition.scenes.bodies import UPRIGHT, about, at
from acquisition.scenes.realistic.meshes import ball, box, drum, sheet
from acquisition.scenes.realistic.physics import Thrown, World
from acquisition.scenes.realistic.rooms.hall import Hall
from acquisition.scenes.realistic.setting import Finish, Setting, Thing

HALL = Hall(wide_m=1.8, low_m=0.8, deep_m=3.0)
SEED, TOP_Y_M = 41, 0.38
CHROME = Finish((0.0, 0.0), mirror=0.85)
BALLS = (  # radius, place, velocity, finish
    (0.12, (-0.45, 1.75), (2.6, 0.2), CHROME),
    (0.09, (0.1, 1.6), (-1.8, 0.3), Finish((0.05, 0.85), "skimage/coins.png", 0.004, 2, gloss=0.0)),
    (0.1, (0.5, 1.95), (-2.4, -0.2), Finish((0.0, 0.25), gloss=0.0)),
    (0.07, (-0.1, 2.1), (1.2, -1.5), CHROME),
)


def chrome_table(seed: int) -> Setting:
    """Build four balls that roll at 2 m/s on a table that mirrors, before walls of photographs."""
    rng = np.random.default_rng([seed, SEED])
    cat, brick = Finish((0.1, 0.85), "skimage/chelsea.png", 0.008), Finish((0.1, 0.7), "skimage/brick.png", 0.008, 2)
    walls = HALL.things(cat, brick, Finish((0.1, 0.5), "skimage/gravel.png", 0.008))
    lacquer = Finish((0.04, 0.3), "pybullet_data/table/table.png", 0.005, 2, gloss=0.0)
    table = Thing("table", box((0.85, 0.04, 0.5)).moved(at(0.0, TOP_Y_M + 0.04, 1.9)), lacquer)
    page = Thing(
        "page",
        sheet((0.75, -0.1, 2.6), (0.3, 0.0, 0.1), (0.0, 0.25, 0.0)),
        Finish((0.0, 0.9), "skimage/page.png", 0.003),
    )
    post = Thing(
        "post", drum(0.06, 0.3).moved(at(-0.7, TOP_Y_M - 0.3, 2.15, UPRIGHT.rotation)), Finish((0.0, 0.6), gloss=0.0)
    )
    lamps = (HALL.lamp(0.3, 1.5, (0.4, 0.3), 14.0), HALL.lamp(-0.9, 2.3, (0.2, 0.2), 16.0))
    return Setting((*walls, table, page, post, *_balls(rng)), HALL.corners, lamps, bounces=4)


def _balls(rng: np.random.Generator) -> list[Thing]:
    with World() as world:
        world.wall((0.85, 0.04, 0.5), (0.0, TOP_Y_M + 0.04, 1.9))
        bodies = []
        for radius, (x, z), (across, along), _ in BALLS:
            place = (x + rng.uniform(-0.02, 0.02), TOP_Y_M - radius - 0.001, z + rng.uniform(-0.02, 0.02))
            spin = (along / radius, 0.0, -across / radius)
            bodies.append(world.add(Thrown(ball(radius), radius**3 * 500, place, (across, 0.0, along), spin, radius)))
        poses = world.run(bodies)
    turned = at(0.0, 0.0, 0.0, about(0, 0.4))
    made = zip(BALLS, poses, strict=True)
    return [Thing(f"ball{n}", ball(b[0], 72).moved(turned), b[3], p) for n, (b, p) in enumerate(made)]
