"""Simulates streams for the image bench: one rendering, several lights, slower planes by dropping or re-integrating.

Letters: T planes, H rows, W columns, k planes to a slow one.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from acquisition.scenes.catalog import build_scene
from acquisition.scenes.view import Scenery
from acquisition.spikes.layout import PlaneLayout
from acquisition.spikes.packing import pack
from acquisition.spikes.sensor import Sensor
from acquisition.spikes.stream import SpikeStream
from reconstruction.bench.conventions import HOLDOUT
from rigs.rig import Rig

CHUNK = 32  # planes rendered at a time
Slowing = Literal["drop", "reintegrate"]


@dataclass(frozen=True, eq=False)
class TrueImage:
    """The light of an instant [H, W] in spikes per tick, its `white`, and the pixels where something `moves` [H, W]."""

    light: NDArray[np.float32]
    white: float
    moves: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class LitScene:
    """A scene and the centre camera's stream of it at each light level, a factor of the scene's own light."""

    scene: Scenery
    rig: Rig
    streams: dict[float, SpikeStream]

    def truths(self, planes: Sequence[float], level: float = 1.0) -> list[TrueImage]:
        """Return the truth in the middle of each of `planes` (a half is between two), its light times `level`."""
        instants_s = np.array([self.rig.clock.instant_s(plane) for plane in planes])
        frames = self.scene.render(self.rig.camera(HOLDOUT), instants_s)
        movers = np.isin(frames.ids, list(self.scene.movers.values()))
        light = frames.intensity * np.float32(level)
        return [TrueImage(a, self.scene.white * level, m) for a, m in zip(light, movers, strict=True)]


def simulate_lights(name: str, seed: int, rig: Rig, planes: int, levels: Sequence[float]) -> LitScene:
    """Render `planes` of a scene once, and let a real sensor see them at each light level."""
    scene, camera = build_scene(name, seed), rig.camera(HOLDOUT)
    layout = PlaneLayout(camera.width, camera.height)
    view = scene.view(camera, 2)
    index = rig.ids.index(HOLDOUT)
    sensors = {level: Sensor(camera.width, camera.height, "real", seed, index, threads=0) for level in levels}
    packed: dict[float, list] = {level: [] for level in levels}
    for first in range(0, planes, CHUNK):
        instants_s = np.array([rig.clock.instant_s(k) for k in range(first, min(first + CHUNK, planes))])
        light = view.light(instants_s)
        for level, sensor in sensors.items():
            packed[level].append(pack(sensor.expose(light * np.float32(level)), layout))
    streams = {k: SpikeStream(np.concatenate(v), layout, rig.tick_rate_hz) for k, v in packed.items()}
    return LitScene(scene, rig, streams)


def slowed(stream: SpikeStream, k: int, how: Slowing, seed: int = 0) -> SpikeStream:
    """Return the stream at a k-th of its plane rate.

    `drop` keeps every k-th plane and loses the light between them. `reintegrate` lets a pixel fire when it has gathered
    k spikes, as one with a k times higher threshold would; planes after the last whole k are left out. Each pixel has
    gathered 0 to k - 1 spikes before the first plane, drawn by `seed`: pixels that began alike would fire in step.
    """
    rate_hz = stream.tick_rate_hz / k
    if how == "drop":
        return SpikeStream(np.ascontiguousarray(stream.packed[::k]), stream.layout, rate_hz)
    whole = len(stream) // k
    gathered = np.random.default_rng(seed).integers(0, k, (stream.layout.height, stream.layout.width))
    slow = np.empty((whole, *gathered.shape), dtype=np.uint8)
    for index in range(whole):
        gathered += stream.counts(index * k, (index + 1) * k)
        slow[index] = gathered >= k
        gathered -= k * slow[index]
    return SpikeStream(pack(slow, stream.layout), stream.layout, rate_hz)


def slow_instant(plane: int, k: int, how: Slowing) -> tuple[int, float]:
    """Return the slow plane that holds `plane`, and the middle of its light in planes of the fast stream."""
    index = plane // k
    return index, index * k + ((k - 1) / 2 if how == "reintegrate" else 0)
