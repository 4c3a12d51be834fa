"""A scene of moving bodies under one sun, seen by any pinhole camera at any instants."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from acquisition.errors import AcquisitionError
from acquisition.progress import Progress, silent
from acquisition.scenes.bodies import Body
from acquisition.scenes.light import EVEN, Flicker, Uneven
from acquisition.scenes.raycast import Floats, Raycaster, SceneArrays
from acquisition.scenes.view import Frames
from rigs.camera import Camera

NOWHERE_M = (0.0, 1e9, -1e9)  # below and behind
STILL_SAMPLES = 4  # least rays a side of a pixel of a view that nothing moving changes


class Placements(NamedTuple):
    """world_from_shape of P shapes at n instants, rotations and positions in metres, and the `gains` of the light."""

    rotations: Floats  # [n, P, 3, 3]
    positions: Floats  # [n, P, 3]
    gains: Floats  # [n]


@dataclass(frozen=True, eq=False)
class Scene:
    """Bodies in the rig frame (metres, x right, y down, z forward) under one sun.

    `white` is the light of a perfectly white surface that faces the sun, in spikes per tick. `ambient` is the fraction
    of it that reaches shadows. `center` is the point the scene happens around. Body i has the object id i + 1. A body
    that is not there yet, or not any more, stands out of sight of every camera and the sun. The scene has been going on
    for `begins_s` at the instant 0. Raises AcquisitionError for bodies, light or textures that no scene can have.
    """

    name: str
    seed: int
    bodies: tuple[Body, ...]
    textures: NDArray[np.float32]  # [K, S, S] in 0..1
    center: tuple[float, float, float]
    to_sun: tuple[float, float, float]
    white: float = 0.6
    ambient: float = 0.3
    background: float = 0.02
    begins_s: float = 0.0
    flicker: Flicker | None = None
    uneven: Uneven = EVEN
    mipmapped: bool = False

    def __post_init__(self) -> None:
        names = [body.name for body in self.bodies]
        if not names or len(set(names)) < len(names) or len(names) > 127:
            raise AcquisitionError(f"found the bodies {names}", "1 to 127 different names", where=f"scene {self.name}")
        if not self.white > 0 or not 0 <= self.ambient <= 1 or not np.linalg.norm(self.to_sun) > 0:
            found = f"found white {self.white}, ambient {self.ambient}, sun {self.to_sun}"
            raise AcquisitionError(found, "above 0, 0..1, and a direction", where=f"scene {self.name}")
        _ = self.arrays  # refuses too many shapes or a texture that is not there

    @property
    def object_ids(self) -> dict[str, int]:
        """The object id of each body by name."""
        return {body.name: i + 1 for i, body in enumerate(self.bodies)}

    @property
    def movers(self) -> dict[str, int]:
        """The object ids of the bodies that move, by name."""
        return {body.name: self.object_ids[body.name] for body in self.bodies if body.moving}

    @functools.cached_property
    def arrays(self) -> SceneArrays:
        """The scene as the ray caster's arrays, shapes in the order of the bodies."""
        owners = [(i, shape) for i, body in enumerate(self.bodies) for shape in body.shapes]
        return SceneArrays(
            shapes=np.array([shape.row() for _, shape in owners], dtype=np.float64),
            moving=np.array(
                [not body.lasting or motion.moving for body in self.bodies for motion in body.motions], dtype=bool
            ),
            ids=np.array([i + 1 for i, _ in owners], dtype=np.int8),
            textures=np.ascontiguousarray(self.textures, dtype=np.float32),
            sun=np.array(self.to_sun) / np.linalg.norm(self.to_sun),
            white=self.white,
            ambient=self.ambient,
            background=self.background,
            uneven=self.uneven,
            mipmapped=self.mipmapped,
        )

    def lit(self, factor: float) -> Self:
        """Return the same scene in `factor` times its light."""
        return replace(self, white=self.white * factor, background=self.background * factor)

    def placements(self, instants_s: NDArray[np.float64]) -> Placements:
        """Find where the shapes are at each of `instants_s` [n], and how bright the light is."""
        instants_s = np.asarray(instants_s, dtype=np.float64) + self.begins_s
        rotations, positions = [], []
        for body in self.bodies:
            gone = ~((instants_s >= body.from_s) & (instants_s < body.to_s))
            poses = {motion: motion.world_from_body(instants_s) for motion in body.motions}
            for shape, motion in zip(body.shapes, body.motions, strict=True):
                turned, moved = poses[motion].of(shape.body_from_shape)
                moved[gone] = NOWHERE_M
                rotations.append(turned)
                positions.append(moved)
        gains = self.flicker.gains(instants_s) if self.flicker else np.ones(len(instants_s))
        return Placements(np.stack(rotations, axis=1), np.stack(positions, axis=1), gains)

    def raycaster(self, camera: Camera, samples: int, threads: int = 0) -> Raycaster:
        """Return a ray caster that has already traced what stands still; feed it `placements`."""
        rotations, positions, _ = self.placements(np.zeros(1))
        return Raycaster(self.arrays, camera, (rotations[0], positions[0]), samples=samples, threads=threads)

    def view(self, camera: Camera, samples: int, threads: int = 0) -> RaycastView:
        """Return what `camera` sees, by a ray caster that has already traced what stands still.

        Pixels that nothing moving changes have STILL_SAMPLES x STILL_SAMPLES rays where `samples` are fewer.
        """
        raycaster = self.raycaster(camera, samples, threads)
        finer = raycaster if samples >= STILL_SAMPLES else self.raycaster(camera, STILL_SAMPLES, threads)
        return RaycastView(self, raycaster, finer.still_intensity)

    def prepare(self, cameras: Sequence[Camera], last_s: float, progress: Progress = silent) -> None:
        """Do nothing: frames are made as fast as they are wanted."""

    def render(self, camera: Camera, instants_s: NDArray[np.float64], samples: int = 4) -> Frames:
        """Render what `camera` (pose in the rig frame) sees at `instants_s` [n], by samples x samples rays a pixel."""
        raycaster = self.raycaster(camera, samples)
        return RaycastView(self, raycaster, raycaster.still_intensity).frames(instants_s)

    def since(self, begins_s: float) -> Self:
        """Return the scene as it is where it has been going on for `begins_s` at the instant 0."""
        return replace(self, begins_s=begins_s)

    def description(self) -> dict[str, Any]:
        """Return what `truth/scene.json` says of the scene: bodies, and how they are lit."""
        return {
            "object_ids": self.object_ids,
            "movers": [self._mover(name) for name in self.movers],
            "light": {
                "ambient": self.ambient,
                "to_sun": list(self.to_sun),
                "flicker": dataclasses.asdict(self.flicker) if self.flicker else None,
                "uneven": dataclasses.asdict(self.uneven) if self.uneven != EVEN else None,
            },
        }

    def _mover(self, name: str) -> dict[str, Any]:
        """Return its id and name and, where it is not always there, from and to which instant in seconds."""
        body = self.bodies[self.object_ids[name] - 1]
        found: dict[str, Any] = {"id": self.object_ids[name], "name": name}
        if not body.lasting:  # None: no end
            ends = ("from_s", body.from_s), ("to_s", body.to_s)
            found |= {key: t if math.isfinite(t) else None for key, t in ends}
        return found


@dataclass(frozen=True, eq=False)
class RaycastView:
    """A scene through a ray caster that belongs to one camera.

    Pixels that nothing moving changes have `still` [H, W], their light by more rays: at an edge that stands still,
    a few rays are wrong by the same light in every plane, which nobody could tell from a texture.
    """

    scene: Scene
    raycaster: Raycaster
    still: NDArray[np.float32]

    def light(self, instants_s: Floats) -> NDArray[np.float32]:
        """Return the linear light at `instants_s` [n], in spikes per tick [n, H, W]."""
        placements = self.scene.placements(instants_s)
        return self._settled(self.raycaster.intensity(*placements), placements.gains)

    def frames(self, instants_s: Floats) -> Frames:
        """Return light, depth and objects at `instants_s` [n]."""
        placements = self.scene.placements(instants_s)
        frames = self.raycaster.frames(*placements)
        return replace(frames, intensity=self._settled(frames.intensity, placements.gains))

    def _settled(self, light: NDArray[np.float32], gains: Floats) -> NDArray[np.float32]:
        """Return `light` [n, H, W] with that of more rays where it is the light of the still part, in place."""
        coarse = self.raycaster.still_intensity
        if self.still is not coarse:
            for image, gain in zip(light, gains.astype(np.float32), strict=True):
                np.copyto(image, gain * self.still, where=image == gain * coarse)
        return light
