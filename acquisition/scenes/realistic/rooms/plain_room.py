"""`plain_room`: painted walls without any texture under soft lamps; a ball and a duck fly through it."""

from __future__ import annotations

import numpy as np

from acquisition.scenes.bodies import UPRIGHT, about, at
from acquisition.scenes.motion import GRAVITY_M_S2, Motion, Vector
from acquisition.scenes.realistic.library import folder_of
from acquisition.scenes.realistic.meshes import Floats, ball, box, drum, read_obj, sheet
from acquisition.scenes.realistic.rooms.hall import Hall
from acquisition.scenes.realistic.setting import Finish, Lamp, Setting, Thing, keyframes_s
from rigs.transform import Transform

HALL = Hall()
SEED = 31


def plain_room(seed: int) -> Setting:
    """Build a room of corners, a cupboard, a plinth, an empty frame and a pipe, none with a texture, and two movers."""
    rng = np.random.default_rng([seed, SEED])
    floor = Finish((0.0, 0.38), gloss=0.4)
    walls = HALL.things(Finish((0.0, 0.66)), Finish((0.0, 0.74)), floor, Finish((0.0, 0.8)))
    window = Lamp((-HALL.wide_m + 0.02, -0.5, 1.0), (0.0, 0.0, 0.5), (0.0, -0.45, 0.0), 5.0)
    lamps = (HALL.lamp(0.5, 1.9, (0.6, 0.4), 8.0), window)
    return Setting((*walls, *_furniture(rng), *_movers(rng)), HALL.corners, lamps)


def _furniture(rng: np.random.Generator) -> list[Thing]:
    x, z = rng.uniform(-0.04, 0.04, 2)
    low = HALL.low_m
    cupboard = box((0.36, 0.62, 0.22)).moved(at(-1.1 + x, low - 0.62, 2.75, about(1, 0.15)))
    plinth = box((0.17, 0.2, 0.17)).moved(at(0.62, low - 0.2, 1.95 + z, about(1, 0.5)))
    return [
        Thing("cupboard", cupboard, Finish((0.0, 0.33))),
        Thing("plinth", plinth, Finish((0.0, 0.55), gloss=0.3)),
        Thing("pipe", drum(0.05, 1.1).moved(at(1.35, -0.37, 3.2, UPRIGHT.rotation)), Finish((0.0, 0.2))),
        Thing("frame", box((0.36, 0.27, 0.02)).moved(at(0.35 + x, -0.42, 3.28)), Finish((0.0, 0.1))),
        Thing("canvas", sheet((0.35 + x, -0.42, 3.255), (0.31, 0.0, 0.0), (0.0, -0.22, 0.0)), Finish((0.0, 0.85))),
    ]


def _movers(rng: np.random.Generator) -> list[Thing]:
    turn = rng.uniform(0, 2 * np.pi)
    duck = read_obj(folder_of("pybullet_data") / "duck.obj").scaled(0.19)
    lies = Transform(about(0, -np.pi / 2) @ about(2, turn), np.zeros(3))
    gliding = _flight((0.55, -0.15, 1.7), (-2.6, 0.1, 0.35), (0.1, 1.0, 0.1), 14.0, fall=0.2)
    thrown = _flight((-0.65, 0.1, 1.55), (2.4, -2.2, 0.3), (0.3, 1.0, 0.5), -18.0)
    return [
        Thing("ball", ball(0.13, 56), Finish((0.06, 0.9), "skimage/coins.png", 0.004, 2), thrown),
        Thing("duck", duck.moved(lies), Finish((0.05, 0.9), "pybullet_data/duckCM.png", 0.0, 4), gliding),
    ]


def _flight(place: Vector, velocity: Vector, axis: Vector, spin_rad_s: float, fall: float = 1.0) -> Floats:
    """Return the poses [K, 3, 4] of free flight from `place` at the trigger, with a share of gravity."""
    motion = Motion(at(*place), axis, spin_rad_s, velocity, (0.0, fall * GRAVITY_M_S2[1], 0.0))
    poses = motion.world_from_body(keyframes_s())
    return np.concatenate([poses.rotations, poses.translations[..., None]], axis=2)
