"""Draws random rooms by the path tracer, to train networks on: soft shadows, plain walls, photographs, gloss.

A view draws what it is asked for and keeps it as long as it lives; nothing goes to the disk, since each room is seen by
one rig and once. Letters: n instants, H rows, W columns.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from acquisition.scenes.motion import GRAVITY_M_S2, Floats, Motion, Vector
from acquisition.scenes.random.clutter import random_turn
from acquisition.scenes.random.photographs import PHOTOGRAPHS
from acquisition.scenes.realistic.meshes import Mesh, ball, box, capsule, drum, sheet
from acquisition.scenes.realistic.rooms.hall import Hall
from acquisition.scenes.realistic.setting import (
    FIRST_S,
    KEYFRAME_S,
    KEYFRAMES,
    Finish,
    Lamp,
    Setting,
    Thing,
    keyframes_s,
)
from acquisition.scenes.realistic.studio import CHUNK, Studio
from acquisition.scenes.view import Frames
from rigs.camera import Camera
from rigs.transform import Transform

PLAIN_SHARE, GLOSSY_SHARE, STILL_SHARE = 0.3, 0.15, 0.6
THINGS = (5, 11)
DEPTH_M, ASIDE = (1.1, 2.7), 0.42  # of things; to the side, as a share of their depth
INSIDE_M = 0.05  # least distance of their middles from the walls
SPEED_M_S, SPIN_RAD_S = (0.3, 6.0), (1.0, 30.0)
BRIGHTEST, WHITE = 0.97, (0.3, 0.95)  # the quantile of the first camera's light that is so many spikes a tick


class Room:
    """Room number `seed` before the cameras of a rig, exposed for the `first` of them at `middle_s`.

    Raises MissingRendererError where no path tracer is installed.
    """

    def __init__(self, seed: int, first: Camera, middle_s: float) -> None:
        rng = np.random.default_rng([seed, 0x64])
        self._studio = Studio(random_room(rng, middle_s))
        self.white = float(rng.uniform(*WHITE))
        brightest = np.quantile(self._studio.true_light(first, middle_s), BRIGHTEST)
        self._level = np.float32(self.white / max(float(brightest), 1e-3))

    def view(self, camera: Camera, samples: int, threads: int = 0) -> RoomView:
        """Return what `camera` sees; rays and threads are the path tracer's choice."""
        return RoomView(self._studio, camera, self._level)


class RoomView:
    """One camera before a room, in `level` times its light."""

    def __init__(self, studio: Studio, camera: Camera, level: np.float32) -> None:
        self._studio, self._camera, self._level = studio, camera, level
        self._drawn: dict[int, NDArray[np.float32]] = {}

    def light(self, instants_s: Floats) -> NDArray[np.float32]:
        """Return the linear light at `instants_s` [n], in spikes per tick [n, H, W], straight between keyframes."""
        places = (np.asarray(instants_s, dtype=np.float64) - FIRST_S) / KEYFRAME_S
        low = np.clip(places.astype(int), 0, KEYFRAMES - 2)
        shares = (places - low).astype(np.float32)[:, None, None]
        before, after = (np.stack([self._keyframe(k) for k in which]) for which in (low, low + 1))
        return (self._level * (before + shares * (after - before))).astype(np.float32)

    def frames(self, instants_s: Floats) -> Frames:
        """Return light, depth and objects at `instants_s` [n]; the light is drawn until its noise is small."""
        light = np.stack([self._studio.true_light(self._camera, float(s)) for s in instants_s])
        looks = [self._studio.look(self._camera, float(s)) for s in instants_s]
        depth, ids = (np.stack(images) for images in zip(*looks, strict=True))
        return Frames(self._level * light, depth, ids)

    def _keyframe(self, number: int) -> NDArray[np.float32]:
        chunk = number // CHUNK
        if chunk not in self._drawn:
            (self._drawn[chunk],) = self._studio.draw([self._camera], chunk)
        return self._drawn[chunk][number % CHUNK]


def random_room(rng: np.random.Generator, middle_s: float) -> Setting:
    """Draw a hall with things that stand in the air as they like; where some move, they are there at `middle_s`."""
    hall = Hall(*(float(rng.uniform(*ends)) for ends in ((1.6, 2.3), (1.2, 1.6), (0.5, 0.9), (2.8, 3.6))))
    walls = hall.things(*(_finish(rng) for _ in range(4)))
    moves = rng.random() >= STILL_SHARE
    things = [_thing(rng, f"thing{n}", hall, middle_s if moves else None) for n in range(rng.integers(*THINGS))]
    lamp = Lamp((float(rng.uniform(-1.2, 1.2)), -1.1, 0.6), (0.15, 0.0, 0.05), (0.02, -0.04, -0.15), 60.0)
    soft = hall.lamp(float(rng.uniform(-0.8, 0.8)), float(rng.uniform(0.8, 2.2)), (0.6, 0.5), 8.0)
    return Setting((*walls, *things), hall.corners, (lamp, soft)[int(rng.integers(2)) :])


def _thing(rng: np.random.Generator, name: str, hall: Hall, middle_s: float | None) -> Thing:
    """Draw a thing somewhere in the hall; every other one moves, if there is an instant `middle_s` to be there at."""
    depth_m = float(rng.uniform(*DEPTH_M))
    ends = (side + way * INSIDE_M for side, way in zip(map(np.array, hall.corners), (1, -1), strict=True))
    center = np.clip([*(depth_m * rng.uniform(-ASIDE, ASIDE, 2)), depth_m], *ends)
    pose = Transform(random_turn(rng), center)
    mesh, finish, moves = _mesh(rng, depth_m), _finish(rng), rng.random() < 0.5
    if middle_s is None or not moves:
        return Thing(name, mesh.moved(pose), finish)
    speed_m_s, spin_rad_s = (float(np.exp(rng.uniform(*np.log(ends)))) for ends in (SPEED_M_S, SPIN_RAD_S))
    fall = GRAVITY_M_S2 if rng.random() < 0.5 else (0.0, 0.0, 0.0)
    motion = Motion(pose, _direction(rng, 1.0), spin_rad_s, _direction(rng, speed_m_s), fall, middle_s)
    poses = motion.world_from_body(keyframes_s())
    return Thing(name, mesh, finish, np.concatenate([poses.rotations, poses.translations[..., None]], 2))


def _direction(rng: np.random.Generator, length: float) -> Vector:
    x, y, z = rng.standard_normal(3)
    scale = length / math.hypot(x, y, z)
    return float(scale * x), float(scale * y), float(scale * z)


def _mesh(rng: np.random.Generator, depth_m: float) -> Mesh:
    a, b, c = (float(side) for side in depth_m * rng.uniform(0.03, 0.16, 3))
    kinds = {
        "box": lambda: box((a, b, c)),
        "ball": lambda: ball(a),
        "egg": lambda: ball(a, squash=float(rng.uniform(0.5, 1.8))),
        "drum": lambda: drum(a, b),
        "capsule": lambda: capsule(a, b),
        "sheet": lambda: sheet((0, 0, 0), (2 * a, 0, 0), (0, 2 * b, 0)),
    }
    return kinds[str(rng.choice(list(kinds)))]()


def _finish(rng: np.random.Generator) -> Finish:
    """Draw a plain finish, or a photograph whose texels are half a pixel to three wide; some lie under a clear coat."""
    low = float(rng.uniform(0.02, 0.4))
    albedo = (low, float(rng.uniform(low + 0.2, 0.95)))
    gloss = float(rng.uniform(0.1, 0.5)) if rng.random() < GLOSSY_SHARE else None
    if rng.random() < PLAIN_SHARE:
        return Finish(albedo, gloss=gloss)
    texel_m = float(np.exp(rng.uniform(*np.log((0.004, 0.025)))))
    return Finish(albedo, str(rng.choice(PHOTOGRAPHS)), texel_m, int(rng.integers(1, 5)), gloss=gloss)
