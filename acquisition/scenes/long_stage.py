"""Builds scenes that go on for any length of time out of shapes."""

from collections.abc import Sequence
from typing import Any

from acquisition.scenes.bodies import Body, Finish, Shape, at
from acquisition.scenes.motion import Vector
from acquisition.scenes.passing import Carrier, Lane, Timetable
from acquisition.scenes.scene import Scene
from acquisition.scenes.stage import Stage

SUN: Vector = (-0.1, -0.85, -0.5)  # steep, so that what is out of sight throws no shadow into it
Passer = tuple[str, Lane, tuple[Shape, ...]]


class LongStage:
    """A stage whose things move without end."""

    def __init__(self, stage: Stage, seed: int, number: int) -> None:
        self.stage = stage
        self._seed, self._number = seed, number
        self._times = Timetable(seed, number)

    def passers(self, things: Sequence[Passer]) -> None:
        """Add things that pass on lanes of their own."""
        names, lanes, shapes = zip(*things, strict=True)
        self.stage.bodies.extend(map(Body, names, shapes, self._times.passing(lanes)))

    def boxes(
        self, name: str, shapes: tuple[Shape, ...], carrier: Carrier, places: Sequence[Vector], boxes: Sequence[Shape]
    ) -> None:
        """Add a carrier of these shapes, and the boxes that it puts down near `places`, a box each."""
        moved, carried = self._times.carrying(carrier, [self.stage.near(*place) for place in places])
        self.stage.bodies.append(Body(name, shapes, moved))
        for i, (shape, way) in enumerate(zip(boxes, carried, strict=True)):
            self.stage.bodies.append(Body(f"box{i}", (shape,), way))

    def scene(self, name: str, **light: Any) -> Scene:
        """Return the scene of all that was added, in steep light."""
        return self.stage.scene(name, self._number, self._seed, **({"to_sun": SUN, "ambient": 0.4} | light))


def cart(stage: Stage, half: Vector, load: Vector, finishes: tuple[Finish, Finish]) -> tuple[Shape, ...]:
    """Return a box of half sizes `half` with a smaller one of `load` on it."""
    return (
        stage.shape("box", half, finishes[0]),
        stage.shape("box", load, finishes[1], at(0.25 * half[0], -half[1] - load[1], 0.0)),
    )
