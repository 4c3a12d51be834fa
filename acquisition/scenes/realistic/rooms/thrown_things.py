"""`thrown_things`: eight things are thrown through one another before walls of photographs; PyBullet moves them."""

from __future__ import annotations

import numpy as np

from acquisition.scenes.bodies import UPRIGHT, about, at
from acquisition.scenes.realistic.library import folder_of
from acquisition.scenes.realistic.meshes import Mesh, ball, box, capsule, drum, read_obj, sheet
from acquisition.scenes.realistic.physics import Thrown, World
from acquisition.scenes.realistic.rooms.hall import Hall
from acquisition.scenes.realistic.setting import FIRST_S, Finish, Lamp, Setting, Thing

HALL = Hall(low_m=0.7, deep_m=3.2)
SEED = 32
MEET_S = 0.008  # when the first of them meet


def thrown_things(seed: int) -> Setting:
    """Build balls, boxes, a duck, a mug and a torus in the air at 2 to 5 m/s, which meet in the middle of the clip."""
    rng = np.random.default_rng([seed, SEED])
    walls = HALL.things(
        Finish((0.12, 0.95), "skimage/brick.png", 0.008, 2),
        Finish((0.1, 0.7), "skimage/brick.png", 0.007, 2),
        Finish((0.05, 0.6), "skimage/gravel.png", 0.006),
    )
    lamp = Lamp((-0.9, -1.35, 0.9), (0.11, 0.0, 0.04), (0.02, -0.03, -0.11), 90.0)
    soft = HALL.lamp(0.7, 1.2, (0.5, 0.5), 8.0)
    return Setting((*walls, *_furniture(rng), *_fliers(rng)), HALL.corners, (lamp, soft))


def _furniture(rng: np.random.Generator) -> list[Thing]:
    x, z = rng.uniform(-0.03, 0.03, 2)
    low = HALL.low_m
    cat = Finish((0.05, 0.9), "skimage/chelsea.png", 0.0032, 2)
    flight = Finish((0.05, 0.9), "skimage/astronaut.png", 0.0047, 4)
    crate = box((0.2, 0.24, 0.18)).moved(at(-0.95 + x, low - 0.24, 2.2, about(1, 0.4)))
    column = drum(0.12, 0.8).moved(at(1.2, low - 0.8, 2.5 + z, UPRIGHT.rotation))
    return [
        Thing("crate", crate, Finish((0.1, 0.8), "pybullet_data/jenga/jenga.png", 0.004, 2)),
        Thing("column", column, Finish((0.05, 0.7), "skimage/grass.png", 0.006)),
        Thing("cat", sheet((0.55 + x, -0.45, 3.19), (0.36, 0.0, 0.0), (0.0, 0.24, 0.0)), cat),
        Thing("flight", sheet((-0.55, -0.5, 3.19), (0.3, 0.0, 0.0), (0.0, 0.3, 0.0)), flight),
    ]


def _fliers(rng: np.random.Generator) -> list[Thing]:
    data = folder_of("pybullet_data")
    duck = _centered(read_obj(data / "duck.obj").scaled(0.16))
    mug = _centered(read_obj(data / "objects" / "mug.obj").scaled(1.9))
    photo = {name: Finish((0.08, 0.9), f"skimage/{name}.png", 0.004, 2) for name in ("coins", "coffee", "ihc", "page")}
    kinds: list[tuple[str, Mesh, Finish, float | None, float]] = [
        ("coin_ball", ball(0.12), photo["coins"], 0.12, 1.0),
        ("grass_ball", ball(0.1), Finish((0.05, 0.8), "skimage/grass.png", 0.004, 1), 0.1, 0.8),
        ("coffee_box", box((0.1, 0.13, 0.08)), photo["coffee"], None, 0.9),
        ("page_box", box((0.13, 0.05, 0.09)), photo["page"], None, 0.7),
        ("capsule", capsule(0.06, 0.1), photo["ihc"], None, 0.6),
        ("duck", duck, Finish((0.05, 0.9), "pybullet_data/duckCM.png", 0.0, 4), None, 0.8),
        ("mug", mug, Finish((0.0, 0.35), gloss=0.2), None, 0.5),
        ("brick", box((0.09, 0.06, 0.06)), Finish((0.1, 0.9), "skimage/brick.png", 0.003), None, 1.2),
    ]
    aims = (  # where each would be at MEET_S if nothing were in the way, and how fast
        ((-0.12, -0.12, 1.6), (3.6, -0.6, 0.2)),
        ((0.1, -0.1, 1.62), (-4.2, 0.3, 0.0)),
        ((0.35, 0.02, 1.85), (-2.4, -2.6, 0.4)),
        ((0.25, 0.28, 1.8), (1.8, -3.4, 0.0)),
        ((-0.5, 0.15, 1.5), (2.2, -2.4, 0.6)),
        ((-0.45, -0.3, 2.0), (2.8, 1.0, -0.3)),
        ((0.62, -0.22, 1.9), (-3.2, 0.6, -0.2)),
        ((-0.1, 0.26, 1.75), (-0.8, -3.0, 0.2)),
    )
    ahead_s = MEET_S - FIRST_S
    with World() as world:
        world.wall((2.0, 0.05, 2.5), (0.0, HALL.low_m + 0.05, 1.2))
        bodies = []
        for (_, mesh, _, radius, mass), (place, velocity) in zip(kinds, aims, strict=True):
            start = np.array(place) + rng.uniform(-0.01, 0.01, 3) - np.array(velocity) * ahead_s
            spin = rng.uniform(-18, 18, 3)
            bodies.append(world.add(Thrown(mesh, mass, tuple(start), velocity, tuple(spin), radius)))
        poses = world.run(bodies)
    return [Thing(name, mesh, finish, flown) for (name, mesh, finish, *_), flown in zip(kinds, poses, strict=True)]


def _centered(mesh: Mesh) -> Mesh:
    """Return the mesh with its middle at the origin, upright for a camera."""
    turned = mesh.moved(at(0.0, 0.0, 0.0, about(0, -np.pi / 2)))
    middle = (turned.vertices.min(axis=0) + turned.vertices.max(axis=0)) / 2
    return turned.moved(at(*-middle))
