"""What a scene is made of: textured convex shapes, rigidly joined into bodies that move."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from acquisition.errors import AcquisitionError
from acquisition.scenes.motion import Motion, Movement
from rigs.transform import Transform

KINDS = ("rectangle", "box", "sphere", "cylinder")  # the order the native ray caster numbers them in


@dataclass(frozen=True)
class Finish:
    """A texture by its index, `texel_m` metres a texel, its 0 and 1 mapped to `albedo`, moved by `shift` texels."""

    texture: int
    texel_m: float
    albedo: tuple[float, float]
    shift: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        if not self.texel_m > 0 or not all(0 <= a <= 1 for a in self.albedo):
            raise AcquisitionError(f"found {self.texel_m} m a texel and albedo {self.albedo}", "> 0 and 0..1")


@dataclass(frozen=True, eq=False)
class Shape:
    """A convex shape centred on its own origin; `size` in metres by kind.

    rectangle (half x, half y, -) in the plane z = 0; box (half x, half y, half z); sphere (radius, -, -);
    cylinder (radius, half height along z, -).
    """

    kind: Literal["rectangle", "box", "sphere", "cylinder"]
    size: tuple[float, ...]
    finish: Finish
    body_from_shape: Transform = field(default_factory=Transform.identity)

    def __post_init__(self) -> None:
        needed = {"rectangle": 2, "box": 3, "sphere": 1, "cylinder": 2}.get(self.kind)
        if needed is None or len(self.size) != needed or not all(s > 0 for s in self.size):
            raise AcquisitionError(f"found a {self.kind} of size {self.size}", f"{KINDS} with positive lengths")

    def row(self) -> list[float]:
        """The shape as the native ray caster reads it [10]."""
        size = [*self.size, 0.0, 0.0][:3]
        finish = self.finish
        return [KINDS.index(self.kind), *size, finish.texture, 1 / finish.texel_m, *finish.shift, *finish.albedo]


@dataclass(frozen=True, eq=False)
class Body:
    """Shapes under one name, as `scene.json` calls it, that move as one or each by a motion of its own.

    The body is there from `from_s` up to but without `to_s`. Raises AcquisitionError where shapes and motions differ
    in number or it never is there.
    """

    name: str
    shapes: tuple[Shape, ...]
    motion: Movement | tuple[Movement, ...]
    from_s: float = -math.inf
    to_s: float = math.inf

    def __post_init__(self) -> None:
        if isinstance(self.motion, tuple) and len(self.motion) != len(self.shapes):
            raise AcquisitionError(
                f"found {len(self.motion)} motions of {len(self.shapes)} shapes", "one for each", where=self.name
            )
        if not self.from_s < self.to_s:
            raise AcquisitionError(f"found from {self.from_s} to {self.to_s} s", "a time between", where=self.name)

    @property
    def motions(self) -> tuple[Movement, ...]:
        """The motion of each shape."""
        return self.motion if isinstance(self.motion, tuple) else (self.motion,) * len(self.shapes)

    @property
    def lasting(self) -> bool:
        """Whether it is there all the time."""
        return math.isinf(self.from_s) and math.isinf(self.to_s)

    @property
    def moving(self) -> bool:
        """Whether any of it moves, appears or goes."""
        return not self.lasting or any(motion.moving for motion in self.motions)


def still(name: str, center: tuple[float, float, float], *shapes: Shape, turn_rad: float = 0.0) -> Body:
    """A body that stands at `center`, turned about the vertical."""
    c, s = np.cos(turn_rad), np.sin(turn_rad)
    return Body(name, shapes, Motion(Transform(np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]), np.array(center))))
