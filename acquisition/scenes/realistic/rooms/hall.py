"""The walls, floor and ceiling that several scenes stand in."""

from __future__ import annotations

from dataclasses import dataclass

from acquisition.scenes.motion import Vector
from acquisition.scenes.realistic.meshes import sheet
from acquisition.scenes.realistic.setting import Finish, Lamp, Thing

MATT = Finish((0.0, 0.6))


@dataclass(frozen=True)
class Hall:
    """A room around the cameras: `wide_m` to each side, `high_m` above, `low_m` below, `deep_m` before, `behind_m`."""

    wide_m: float = 1.9
    high_m: float = 1.5
    low_m: float = 0.75
    deep_m: float = 3.3
    behind_m: float = 1.0

    @property
    def corners(self) -> tuple[Vector, Vector]:
        """The lowest and highest coordinates of the room."""
        return (-self.wide_m, -self.high_m, -self.behind_m), (self.wide_m, self.low_m, self.deep_m)

    def things(
        self, back: Finish = MATT, sides: Finish = MATT, floor: Finish = MATT, top: Finish = MATT
    ) -> list[Thing]:
        """Return walls, floor and ceiling; the wall behind the cameras is finished as those at their sides."""
        middle, tall = (self.low_m - self.high_m) / 2, (self.low_m + self.high_m) / 2
        deep = (self.deep_m + self.behind_m) / 2
        z, wide = self.deep_m - deep, self.wide_m
        return [
            Thing("back", sheet((0, middle, self.deep_m), (wide, 0, 0), (0, -tall, 0)), back),
            Thing("front", sheet((0, middle, -self.behind_m), (wide, 0, 0), (0, tall, 0)), sides),
            Thing("left", sheet((-wide, middle, z), (0, 0, deep), (0, -tall, 0)), sides),
            Thing("right", sheet((wide, middle, z), (0, 0, -deep), (0, -tall, 0)), sides),
            Thing("ceiling", sheet((0, -self.high_m, z), (wide, 0, 0), (0, 0, -deep)), top),
            Thing("floor", sheet((0, self.low_m, z), (wide, 0, 0), (0, 0, deep)), floor),
        ]

    def lamp(self, x: float, z: float, half: tuple[float, float], radiance: float) -> Lamp:
        """Return a panel under the ceiling that shines down."""
        return Lamp((x, -self.high_m + 0.02, z), (half[0], 0, 0), (0, 0, -half[1]), radiance)
