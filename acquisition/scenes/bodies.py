"""The parts of a scene: textured convex shapes, rigidly joined into bodies that move."""

import math
from dataclasses import dataclass, field
from typing import Literal, get_args

import numpy as np

from acquisition.errors import AcquisitionError
from acquisition.scenes.motion import Floats, Motion, Movement, Vector
from rigs.transform import Transform

UPRIGHT = Transform(np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]), np.zeros(3))  # a cylinder's z along the vertical
Kind = Literal["rectangle", "box", "sphere", "cylinder"]  # in the order the native ray caster numbers them
KINDS: tuple[Kind, ...] = get_args(Kind)


@dataclass(frozen=True)
class Finish:
    """A texture by its number, `texel_m` metres a texel, its 0 and 1 mapped to `albedo`, moved by `shift` texels."""

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

    kind: Kind
    size: tuple[float, ...]
    finish: Finish
    body_from_shape: Transform = field(default_factory=Transform.identity)

    def __post_init__(self) -> None:
        needed = {"rectangle": 2, "box": 3, "sphere": 1, "cylinder": 2}.get(self.kind)
        if needed is None or len(self.size) != needed or not all(s > 0 for s in self.size):
            raise AcquisitionError(f"found a {self.kind} of size {self.size}", f"{KINDS} with positive lengths")

    def row(self) -> list[float]:
        """Return the shape as the native ray caster reads it [10]."""
        size = [*self.size, 0.0, 0.0][:3]
        finish = self.finish
        return [KINDS.index(self.kind), *size, finish.texture, 1 / finish.texel_m, *finish.shift, *finish.albedo]


@dataclass(frozen=True, eq=False)
class Body:
    """Shapes under one name, as `scene.json` calls it, that move as one or each by a motion of its own.

    The body is there from `from_s` up to but without `to_s`. Raises AcquisitionError where the numbers of
    shapes and motions differ, or where the body never is there.
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
        """True where the body is there all the time."""
        return math.isinf(self.from_s) and math.isinf(self.to_s)

    @property
    def moving(self) -> bool:
        """True where any part of the body moves, appears or goes."""
        return not self.lasting or any(motion.moving for motion in self.motions)


def still(name: str, center: Vector, *shapes: Shape, turn_rad: float = 0.0) -> Body:
    """Return a body that stands at `center`, turned about the vertical."""
    return Body(name, shapes, Motion(at(*center, about(1, turn_rad))))


def at(x: float, y: float, z: float, turned: Floats | None = None) -> Transform:
    """Return the pose of a thing that stands there, in metres, turned by a rotation [3, 3] or upright."""
    return Transform(np.eye(3) if turned is None else turned, np.array([x, y, z]))


def about(axis: int, angle_rad: float) -> Floats:
    """Return the turn [3, 3] about the x, y or z axis (0, 1, 2)."""
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    turned = np.eye(3)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    turned[i, i], turned[i, j], turned[j, i], turned[j, j] = c, -s, s, c
    return turned
