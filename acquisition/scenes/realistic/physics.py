"""Moves rigid things by PyBullet, a step of its solver for each plane of 20 kHz.

The engine's frame is the rig's: gravity pulls along +y. Letters: K keyframes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from acquisition.scenes.motion import GRAVITY_M_S2, Vector
from acquisition.scenes.realistic.library import needed
from acquisition.scenes.realistic.meshes import Floats, Mesh
from acquisition.scenes.realistic.setting import KEYFRAME_S, KEYFRAMES

STEPS = 4  # of the solver between keyframes
RESTITUTION, FRICTION = 0.6, 0.5


@dataclass(frozen=True, eq=False)
class Thrown:
    """A thing in the air at the first keyframe: where, how fast, how it turns.

    Its outside is the convex hull of `mesh`, or a ball of `radius_m` where that is given.
    """

    mesh: Mesh
    mass_kg: float
    place_m: Vector
    velocity_m_s: Vector
    spin_rad_s: Vector = (0.0, 0.0, 0.0)
    radius_m: float | None = None


class World:
    """A solver and what is in it; `close` it, or use it in a `with`."""

    def __init__(self) -> None:
        self.engine = needed("pybullet")
        self.client = self.engine.connect(self.engine.DIRECT)
        self.engine.setGravity(*GRAVITY_M_S2, physicsClientId=self.client)
        self.engine.setTimeStep(KEYFRAME_S / STEPS, physicsClientId=self.client)

    def __enter__(self) -> World:
        """Return itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Leave the solver."""
        self.engine.disconnect(physicsClientId=self.client)

    def add(self, thrown: Thrown) -> int:
        """Add a thing and return its number."""
        if thrown.radius_m is not None:
            outside = {"shapeType": self.engine.GEOM_SPHERE, "radius": thrown.radius_m}
        else:
            outside = {"shapeType": self.engine.GEOM_MESH, "vertices": np.unique(thrown.mesh.vertices, axis=0).tolist()}
        shape = self.engine.createCollisionShape(**outside, physicsClientId=self.client)
        body = self._body(thrown.mass_kg, shape, thrown.place_m)
        velocity, spin = list(thrown.velocity_m_s), list(thrown.spin_rad_s)
        self.engine.resetBaseVelocity(body, velocity, spin, physicsClientId=self.client)
        return body

    def wall(self, half: Vector, place_m: Vector) -> int:
        """Add a box that nothing moves, and return its number."""
        kind = self.engine.GEOM_BOX
        shape = self.engine.createCollisionShape(kind, halfExtents=list(half), physicsClientId=self.client)
        return self._body(0.0, shape, place_m)

    def run(self, bodies: Sequence[int], before_step: Any = None) -> list[Floats]:
        """Return the poses [K, 3, 4] of `bodies` at all keyframes; `before_step(n)` is called before each step."""
        found = [np.empty((KEYFRAMES, 3, 4)) for _ in bodies]
        for keyframe in range(KEYFRAMES):
            for poses, body in zip(found, bodies, strict=True):
                poses[keyframe] = self.pose(body)
            for step in range(STEPS):
                if before_step:
                    before_step(keyframe * STEPS + step)
                self.engine.stepSimulation(physicsClientId=self.client)
        return found

    def pose(self, body: int) -> Floats:
        """Return where a body is now [3, 4]."""
        return self.matrix(*self.engine.getBasePositionAndOrientation(body, physicsClientId=self.client))

    def matrix(self, place_m: Sequence[float], quat_xyzw: Sequence[float]) -> Floats:
        """Return the pose [3, 4] of a place and a quaternion as the engine writes them."""
        turn = np.array(self.engine.getMatrixFromQuaternion(quat_xyzw)).reshape(3, 3)
        return np.c_[turn, place_m]

    def _body(self, mass_kg: float, shape: int, place_m: Vector) -> int:
        body = self.engine.createMultiBody(mass_kg, shape, basePosition=list(place_m), physicsClientId=self.client)
        kind = {"restitution": RESTITUTION, "lateralFriction": FRICTION, "linearDamping": 0.0, "angularDamping": 0.0}
        self.engine.changeDynamics(body, -1, **kind, physicsClientId=self.client)
        return body
