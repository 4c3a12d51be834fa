"""`banner`: printed cloths wave and a paper lantern swings before shelves, in light from two sides."""

from __future__ import annotations

import numpy as np

from acquisition.scenes.bodies import about, at
from acquisition.scenes.realistic.meshes import Floats, ball, box, sheet
from acquisition.scenes.realistic.rooms.hall import Hall
from acquisition.scenes.realistic.setting import Finish, Lamp, Setting, Thing, keyframes_s

HALL = Hall(wide_m=1.8, low_m=0.75, deep_m=3.1)
SEED = 44


def banner(seed: int) -> Setting:
    """Build two cloths with travelling waves, a lantern on a string, and shelves of boxes."""
    rng = np.random.default_rng([seed, SEED])
    walls = HALL.things(
        Finish((0.4, 0.7), "skimage/moon.png", 0.008),
        Finish((0.0, 0.65)),
        Finish((0.08, 0.5), "skimage/brick.png", 0.006, 2),
    )
    window = Lamp((HALL.wide_m - 0.02, -0.4, 1.3), (0.0, 0.0, -0.4), (0.0, -0.5, 0.0), 10.0)
    lamps = (HALL.lamp(-0.7, 1.4, (0.25, 0.25), 18.0), window)
    large = _cloth(
        "banner", (-0.3, -0.1, 1.85), (0.42, 0.3), Finish((0.05, 0.9), "skimage/astronaut.png", 0.0033, 2), rng
    )
    small = _cloth("flag", (0.62, 0.12, 1.6), (0.22, 0.15), Finish((0.05, 0.9), "skimage/coffee.png", 0.003, 4), rng)
    return Setting((*walls, *_shelves(rng), large, small, _lantern(rng)), HALL.corners, lamps)


def _cloth(
    name: str, middle: tuple[float, float, float], half: tuple[float, float], finish: Finish, rng: np.random.Generator
) -> Thing:
    """Return a sheet held at its left, whose waves run to the right and grow on their way."""
    mesh = sheet(middle, (half[0], 0, 0), (0, half[1], 0), (48, 32))
    along, high = (mesh.vertices[:, 0] - middle[0]) / half[0], (mesh.vertices[:, 1] - middle[1]) / half[1]
    phase, free = rng.uniform(0, 2 * np.pi), (along + 1) / 2
    bent = np.tile(mesh.vertices, (len(keyframes_s()), 1, 1))
    for keyframe, instant_s in enumerate(keyframes_s()):
        turn = 5.0 * along + 0.8 * high - 40.0 * instant_s + phase
        bent[keyframe, :, 2] += 0.09 * free * np.sin(turn)
        bent[keyframe, :, 1] += 0.02 * free * np.cos(0.7 * turn)
        bent[keyframe, :, 0] -= 0.03 * free * np.cos(turn) ** 2
    return Thing(name, mesh, finish, bent=bent)


def _lantern(rng: np.random.Generator) -> Thing:
    swing: Floats = 0.5 * np.sin(6.0 * keyframes_s() + rng.uniform(0, 1))
    poses = []
    for angle in swing:
        turned = about(2, float(angle))
        poses.append(np.c_[turned, np.array([0.3, -0.85, 2.1]) + turned @ (0.0, 0.55, 0.0)])
    return Thing("lantern", ball(0.12, 48, 1.3), Finish((0.1, 0.9), "skimage/ihc.png", 0.004, 2), np.stack(poses))


def _shelves(rng: np.random.Generator) -> list[Thing]:
    things = []
    for row, y in enumerate((-0.35, 0.25)):
        things.append(Thing(f"shelf{row}", box((0.75, 0.02, 0.15)).moved(at(0.6, y, 2.85)), Finish((0.0, 0.4))))
        for column in range(4):
            half = rng.uniform((0.05, 0.07, 0.06), (0.1, 0.14, 0.1))
            place = at(0.05 + 0.36 * column, y - 0.02 - half[1], 2.8, about(1, rng.uniform(-0.4, 0.4)))
            picture = ("coins", "page", "text", "cell")[(column + row) % 4]
            things.append(
                Thing(
                    f"box{row}{column}", box(half).moved(place), Finish((0.1, 0.85), f"skimage/{picture}.png", 0.005, 2)
                )
            )
    return things
