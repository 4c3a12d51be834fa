"""`marbles`: sixteen marbles roll down a tilted tray and over its edge, past a striped fence."""

from __future__ import annotations

import numpy as np

from acquisition.scenes.bodies import UPRIGHT, about, at
from acquisition.scenes.realistic.meshes import ball, box, drum
from acquisition.scenes.realistic.physics import Thrown, World
from acquisition.scenes.realistic.rooms.hall import Hall
from acquisition.scenes.realistic.setting import Finish, Setting, Thing

HALL = Hall(wide_m=1.7, low_m=0.8, deep_m=3.0)
SEED, RADIUS_M, TILT_RAD = 45, 0.05, 0.45
PICTURES = ("coins", "cell", "ihc", "moon")


def marbles(seed: int) -> Setting:
    """Build a tray that falls to the right, sixteen marbles on their way down, and things that stand about."""
    rng = np.random.default_rng([seed, SEED])
    walls = HALL.things(
        Finish((0.2, 0.7), "skimage/grass.png", 0.009),
        Finish((0.1, 0.6), "skimage/gravel.png", 0.008),
        Finish((0.0, 0.45)),
    )
    tray = box((0.75, 0.02, 0.4)).moved(at(-0.2, 0.38, 1.8, about(2, TILT_RAD)))
    things = [
        Thing("tray", tray, Finish((0.08, 0.55), "pybullet_data/tray/tray.jpg", 0.004, 2)),
        Thing("leg", drum(0.05, 0.25).moved(at(-0.6, 0.6, 1.95, UPRIGHT.rotation)), Finish((0.0, 0.25))),
        Thing(
            "crate",
            box((0.2, 0.25, 0.2)).moved(at(0.95, 0.55, 2.2, about(1, 0.5))),
            Finish((0.1, 0.8), "skimage/page.png", 0.005),
        ),
    ]
    fence = [drum(0.02, 0.5, 16).moved(at(-1.2 + 0.3 * k, 0.3, 2.75, UPRIGHT.rotation)) for k in range(9)]
    things += [
        Thing("fence" if k % 2 else "posts", rod, Finish((0.0, 0.8 if k % 2 else 0.15))) for k, rod in enumerate(fence)
    ]
    lamps = (HALL.lamp(0.4, 1.2, (0.15, 0.15), 60.0), HALL.lamp(-0.8, 1.8, (0.4, 0.4), 8.0))
    return Setting((*walls, *things, *_rolling(rng)), HALL.corners, lamps)


def _rolling(rng: np.random.Generator) -> list[Thing]:
    marble, slope = ball(RADIUS_M, 24), about(2, TILT_RAD)
    down, off = slope[:, 0], -slope[:, 1]
    with World() as world:
        # The tray for the solver: flat in its own frame.
        engine = world.engine
        flat = world.wall((0.75, 0.02, 0.4), (-0.2, 0.38, 1.8))
        lies = engine.getQuaternionFromEuler((0.0, 0.0, TILT_RAD))
        engine.resetBasePositionAndOrientation(flat, (-0.2, 0.38, 1.8), lies, physicsClientId=world.client)
        bodies = []
        for number in range(16):
            along, across = -0.6 + 0.16 * (number % 8) + rng.uniform(-0.02, 0.02), -0.22 + 0.3 * (number // 8)
            place = np.array([-0.2, 0.38, 1.8]) + along * down + (0.02 + RADIUS_M + 0.001) * off
            place[2] += across + rng.uniform(-0.06, 0.06)
            speed = rng.uniform(1.2, 2.6)
            spin = (0.0, 0.0, speed / RADIUS_M)
            bodies.append(world.add(Thrown(marble, 0.1, tuple(place), tuple(speed * down), spin, RADIUS_M)))
        poses = world.run(bodies)
    looks = [Finish((0.05, 0.9), f"skimage/{PICTURES[n % 4]}.png", 0.0025, 2, gloss=0.15) for n in range(16)]
    return [Thing(f"marble{n}", marble, looks[n], poses[n]) for n in range(16)]
