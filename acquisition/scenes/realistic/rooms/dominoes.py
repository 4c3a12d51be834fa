"""`dominoes`: a row of dominoes falls over a desk with books and a mug; a pendulum strikes the first one."""

from __future__ import annotations

import numpy as np

from acquisition.scenes.bodies import about, at
from acquisition.scenes.realistic.library import folder_of
from acquisition.scenes.realistic.meshes import ball, box, read_obj
from acquisition.scenes.realistic.physics import Thrown, World
from acquisition.scenes.realistic.rooms.hall import Hall
from acquisition.scenes.realistic.setting import Finish, Setting, Thing

HALL = Hall(wide_m=1.7, low_m=0.9, deep_m=2.9)
SEED, TOP_Y_M, COUNT = 42, 0.4, 11
HALF_M = (0.018, 0.12, 0.06)
PICTURES = ("pybullet_data/domino/domino.jpg", "skimage/text.png", "skimage/clock_motion.png")


def dominoes(seed: int) -> Setting:
    """Build eleven dominoes in a bow, already falling one after another, and a ball that rolls towards them."""
    rng = np.random.default_rng([seed, SEED])
    walls = HALL.things(
        Finish((0.3, 0.75), "skimage/ihc.png", 0.007),
        Finish((0.0, 0.6)),
        Finish((0.1, 0.4), "skimage/grass.png", 0.008),
    )
    desk = Thing(
        "desk",
        box((0.9, 0.03, 0.4)).moved(at(0.0, TOP_Y_M + 0.03, 1.75)),
        Finish((0.08, 0.5), "pybullet_data/table/table.png", 0.004, 2, gloss=0.2),
    )
    lamps = (HALL.lamp(-0.5, 1.3, (0.3, 0.3), 20.0), HALL.lamp(0.9, 1.9, (0.3, 0.15), 16.0))
    return Setting((*walls, desk, *_books(rng), *_falling(rng)), HALL.corners, lamps)


def _books(rng: np.random.Generator) -> list[Thing]:
    mug = read_obj(folder_of("pybullet_data") / "objects" / "mug.obj").scaled(1.6)
    books = []
    for number, (picture, shade) in enumerate((("page", 0.9), ("text", 0.7), ("camera", 0.85))):
        height = TOP_Y_M - 0.03 - 0.06 * number
        book = box((0.17 - 0.015 * number, 0.03, 0.12)).moved(at(0.62, height, 1.95, about(1, rng.uniform(-0.4, 0.4))))
        books.append(Thing(f"book{number}", book, Finish((0.05, shade), f"skimage/{picture}.png", 0.003, 2)))
    stands = at(-0.62, TOP_Y_M, 2.0, about(0, np.pi / 2))
    return [*books, Thing("mug", mug.moved(stands), Finish((0.0, 0.6), gloss=0.15))]


def _falling(rng: np.random.Generator) -> list[Thing]:
    stone, roller = box(HALF_M), ball(0.07)
    with World() as world:
        world.wall((0.9, 0.03, 0.4), (0.0, TOP_Y_M + 0.03, 1.75))
        bodies = []
        for number in range(COUNT):
            place = (-0.5 + 0.085 * number, TOP_Y_M - HALF_M[1] - 0.001, 1.6 + 0.012 * (number - 5) ** 2 / 3)
            push = max(0.0, 9.0 - 1.6 * number)  # the first ones are on their way
            bodies.append(world.add(Thrown(stone, 0.3, place, (push * HALF_M[1], 0.0, 0.0), (0.0, 0.0, push))))
        start = (0.45, TOP_Y_M - 0.071, 1.5 + rng.uniform(-0.02, 0.02))
        bodies.append(world.add(Thrown(roller, 0.6, start, (-2.2, 0.0, 0.1), (0.0, 0.0, 31.0), 0.07)))
        poses = world.run(bodies)
    faces = [Finish((0.08, 0.9), PICTURES[n % 3], 0.003, 2) for n in range(COUNT)]
    stones = [Thing(f"stone{n}", stone, faces[n], poses[n]) for n in range(COUNT)]
    return [*stones, Thing("roller", roller, Finish((0.05, 0.9), "skimage/coins.png", 0.003, 2), poses[-1])]
