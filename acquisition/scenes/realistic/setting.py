"""Describes all that a painter needs: things, their material, the light, and how they move.

Letters: K keyframes, V vertices. The rig frame is in metres, x right, y down, z forward.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from acquisition.errors import AcquisitionError
from acquisition.scenes.motion import Vector
from acquisition.scenes.realistic.meshes import Floats, Mesh

KEYFRAME_S = 0.0002  # between drawn frames, four planes of 20 kHz
FIRST_S = 0.000025 - 40 * KEYFRAME_S  # of the first keyframe; the middle of plane 0 at 20 kHz is one too
LASTS_S = 0.25  # after the trigger; longer recordings are refused
KEYFRAMES = round((LASTS_S - FIRST_S) / KEYFRAME_S) + 1


@dataclass(frozen=True)
class Finish:
    """The way a surface scatters light.

    Its albedo runs from `albedo[0]` to `albedo[1]` with the light of `picture`, a name of `pictures`, after means of
    `shrink` x `shrink` texels, each then `texel_m` wide: about a pixel, else no two cameras agree on it. Without a
    picture it is `albedo[1]`. `texel_m` 0 lays the picture by the mesh's own coordinates in 0..1. `gloss` is the
    roughness of a clear coat under which it lies, None for none; 0 mirrors sharply. `mirror` is the share that a metal
    reflects, sharply.
    """

    albedo: tuple[float, float]
    picture: str = ""
    texel_m: float = 0.006
    shrink: int = 1
    gloss: float | None = None
    mirror: float = 0.0

    def __post_init__(self) -> None:
        if not 0 <= min(self.albedo) <= max(self.albedo) <= 1 or not 0 <= self.mirror <= 1 or self.texel_m < 0:
            raise AcquisitionError(f"found the finish {self}", "albedo and mirror in 0..1, texels of 0 m or more")


@dataclass(frozen=True, eq=False)
class Thing:
    """A mesh in its own frame with a finish; it belongs to the object `body`.

    `poses` [K, 3, 4] place it at each keyframe; a thing that bends has `bent` [K, V, 3] instead; a still one has
    neither and stands where its mesh is.
    """

    body: str
    mesh: Mesh
    finish: Finish
    poses: Floats | None = None
    bent: Floats | None = None

    @property
    def moving(self) -> bool:
        """True where it is not the same at every keyframe."""
        return self.poses is not None or self.bent is not None

    def vertices(self, instant_s: float) -> Floats:
        """Return where its vertices are [V, 3], between keyframes on straight lines."""
        if not self.moving:
            return self.mesh.vertices
        place = np.clip((instant_s - FIRST_S) / KEYFRAME_S, 0, KEYFRAMES - 1)
        low = min(int(place), KEYFRAMES - 2)
        before, after = self._at(low), self._at(low + 1)
        return before + (place - low) * (after - before)

    def _at(self, keyframe: int) -> Floats:
        if self.bent is not None:
            return self.bent[keyframe]
        assert self.poses is not None
        return self.mesh.vertices @ self.poses[keyframe][:, :3].T + self.poses[keyframe][:, 3]


@dataclass(frozen=True)
class Lamp:
    """A panel of even light about `center` with half edges `across` and `down`; it shines towards across x down.

    `radiance` is in spikes per tick: a white surface that sees nothing but the lamp all around is as bright.
    """

    center: Vector
    across: Vector
    down: Vector
    radiance: float


@dataclass(frozen=True, eq=False)
class Setting:
    """Everything before the cameras. `corners` hold all of it, for the light that surfaces pass on to one another.

    A sky and a sun are lamps too, large or far. `bounces` counts the surfaces that a ray meets at most, two or more
    with mirrors.
    """

    things: Sequence[Thing]
    corners: tuple[Vector, Vector]
    lamps: Sequence[Lamp]
    bounces: int = 1
    names: tuple[str, ...] = field(init=False)

    def __post_init__(self) -> None:
        names = tuple(dict.fromkeys(thing.body for thing in self.things))
        if not 1 <= len(names) <= 127:
            raise AcquisitionError(f"found {len(names)} bodies", "1 to 127")
        object.__setattr__(self, "names", names)

    @property
    def glossy(self) -> bool:
        """True where a thing has a coat or mirrors."""
        return any(thing.finish.gloss is not None or thing.finish.mirror for thing in self.things)

    @property
    def object_ids(self) -> dict[str, int]:
        """The object id of each body by name."""
        return {name: number + 1 for number, name in enumerate(self.names)}

    @property
    def movers(self) -> dict[str, int]:
        """The object ids of the bodies that move, by name."""
        moving = {thing.body for thing in self.things if thing.moving}
        return {name: number for name, number in self.object_ids.items() if name in moving}


def keyframes_s() -> Floats:
    """Return the instants of all keyframes [K]."""
    return FIRST_S + KEYFRAME_S * np.arange(KEYFRAMES, dtype=np.float64)
