"""`courtyard`: brick walls in the sun under a bright sky; a ball, a bear and a brick bounce, a sign turns."""

from __future__ import annotations

import numpy as np

from acquisition.scenes.bodies import UPRIGHT, about, at
from acquisition.scenes.realistic.library import folder_of
from acquisition.scenes.realistic.meshes import ball, box, drum, joined, read_obj, sheet
from acquisition.scenes.realistic.physics import Thrown, World
from acquisition.scenes.realistic.setting import Finish, Lamp, Setting, Thing, keyframes_s

SEED, GROUND_Y_M = 43, 0.75
CORNERS = ((-4.0, -3.0, -1.5), (4.0, GROUND_Y_M, 6.0))
SUN = Lamp((-4.5, -5.5, -3.0), (0.12, -0.136, 0.12), (0.1, 0.0, -0.112), 1050.0)
SKY = Lamp((0.0, -6.0, 4.0), (9.0, 0.0, 0.0), (0.0, 0.0, -8.0), 0.35)
HORIZON = Lamp((0.0, -2.0, 9.0), (9.0, 0.0, 0.0), (0.0, -4.0, 0.0), 0.5)


def courtyard(seed: int) -> Setting:
    """Build a yard that is open to the sky behind a low wall, and four things that move in it."""
    rng = np.random.default_rng([seed, SEED])
    brick = Finish((0.1, 0.65), "skimage/brick.png", 0.009, 2)
    gravel = Finish((0.08, 0.5), "skimage/gravel.png", 0.008)
    things = [
        Thing("ground", sheet((0, GROUND_Y_M, 2.5), (4, 0, 0), (0, 0, 4)), gravel),
        Thing("house", box((0.9, 1.6, 0.5)).moved(at(-1.9, GROUND_Y_M - 1.6, 3.3, about(1, 0.2))), brick),
        Thing("wall", box((2.5, 0.35, 0.12)).moved(at(1.0, GROUND_Y_M - 0.35, 3.6)), brick),
        Thing("trunk", drum(0.13, 1.3).moved(at(1.3, GROUND_Y_M - 1.3, 2.7, UPRIGHT.rotation)), _leafy("grass", 0.5)),
        Thing("hedge", ball(0.45, 40).moved(at(0.35, GROUND_Y_M - 0.3, 3.1)), _leafy("grass", 0.45)),
    ]
    return Setting((*things, *_movers(rng)), CORNERS, (SUN, SKY, HORIZON))


def _leafy(picture: str, most: float) -> Finish:
    return Finish((0.05, most), f"skimage/{picture}.png", 0.006)


def _movers(rng: np.random.Generator) -> list[Thing]:
    bear = read_obj(folder_of("pybullet_data") / "teddy2_VHACD_CHs.obj")
    middle = (bear.vertices.min(axis=0) + bear.vertices.max(axis=0)) / 2
    size = float(np.ptp(bear.vertices, axis=0).max())
    bear = bear.moved(at(*-middle)).scaled(0.34 / size).moved(at(0.0, 0.0, 0.0, about(0, -np.pi / 2)))
    kinds = (
        ("football", ball(0.12), Finish((0.06, 0.9), "skimage/chessboard_GRAY.png", 0.003), 0.12, 0.4),
        ("bear", bear, Finish((0.1, 0.7), "skimage/moon.png", 0.0008), None, 0.5),
        ("brick", box((0.12, 0.06, 0.06)), Finish((0.1, 0.7), "skimage/brick.png", 0.003), None, 2.0),
    )
    aims = (
        ((-0.5, -0.1, 1.8), (3.4, -0.8, 0.5)),
        ((0.35, 0.05, 2.0), (-1.8, -2.4, 0.2)),
        ((0.05, 0.35, 1.6), (1.2, -2.8, 0.3)),
    )
    with World() as world:
        world.wall((4.0, 0.1, 4.0), (0.0, GROUND_Y_M + 0.1, 2.5))
        bodies = []
        for (_, mesh, _, radius, mass), (place, velocity) in zip(kinds, aims, strict=True):
            start = tuple(np.array(place) - 0.015 * np.array(velocity) + rng.uniform(-0.02, 0.02, 3))
            bodies.append(world.add(Thrown(mesh, mass, start, velocity, tuple(rng.uniform(-15, 15, 3)), radius)))
        poses = world.run(bodies)
    turning = np.stack([np.c_[about(1, 14.0 * t), (0.75, -0.35, 2.1)] for t in keyframes_s()])
    vane = joined(box((0.2, 0.09, 0.008)), drum(0.012, 0.16, 16).moved(at(0, 0, 0, UPRIGHT.rotation)))
    sign = Thing("sign", vane, Finish((0.05, 0.9), "skimage/text.png", 0.003), turning)
    return [*(Thing(k[0], k[1], k[2], p) for k, p in zip(kinds, poses, strict=True)), sign]
