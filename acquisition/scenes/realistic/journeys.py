"""Makes things of movements in closed form, and a hall through which they pass for as long as a scene is drawn."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from acquisition.scenes.motion import Movement, Vector
from acquisition.scenes.passing import Carrier, Lane, Timetable
from acquisition.scenes.realistic.meshes import Mesh
from acquisition.scenes.realistic.setting import Finish, Thing, keyframes_s

Parts = Sequence[tuple[Mesh, Finish]]
Passer = tuple[str, Lane, Parts]


class Delivery(NamedTuple):
    """A carrier `name` made of `parts`, and the boxes that it puts down on `places`, a box each."""

    name: str
    parts: Parts
    carrier: Carrier
    places: Sequence[Vector]
    boxes: Parts


def moved(name: str, parts: Parts, movement: Movement) -> list[Thing]:
    """Return the parts of a body that move as one."""
    poses = movement.world_from_body(keyframes_s())
    placed = np.concatenate([poses.rotations, poses.translations[..., None]], axis=2)  # [K, 3, 4]
    return [Thing(name, mesh, finish, placed) for mesh, finish in parts]


def passers(times: Timetable, things: Sequence[Passer]) -> list[Thing]:
    """Return things that pass on lanes of their own."""
    ways = times.passing([lane for _, lane, _ in things])
    return [one for (name, _, parts), way in zip(things, ways, strict=True) for one in moved(name, parts, way)]


def delivered(times: Timetable, delivery: Delivery) -> list[Thing]:
    """Return a carrier and the boxes that it brings."""
    way, ways = times.carrying(delivery.carrier, delivery.places)
    boxes = [
        one
        for i, (box, carried) in enumerate(zip(delivery.boxes, ways, strict=True))
        for one in moved(f"box{i}", [box], carried)
    ]
    return [*moved(delivery.name, delivery.parts, way), *boxes]
