"""Clips of several views to train on: packed planes, true light and depth at the middle plane, true cameras.

A clip's seed is its number: scene, rig, pixels and noise follow from it. Letters: V views, T planes, H rows, W columns.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from acquisition.progress import Progress, silent
from acquisition.scenes.multiview import multiview_scene, random_rig
from acquisition.scenes.source import SceneSource
from acquisition.spikes.layout import PlaneLayout
from acquisition.spikes.sensor import Sensor
from acquisition.spikes.stream import SpikeStream
from reconstruction.errors import BadRunError
from reconstruction.networks.rates import REACH
from reconstruction.networks.training.image_clips import clip_path, fill_folder, read_document, require_whole
from rigs.rig import Rig

SCHEMA = 1
SAMPLES = 3  # rays a side of a pixel in the truth
PLANES, INSTANT = 2 * REACH + 1, REACH


@dataclass(frozen=True)
class MultiviewSet:
    """Clips with the seeds `first_seed` ... `first_seed + count - 1` of `views` cameras of `width` x `height` px."""

    first_seed: int
    count: int
    views: int = 4
    width: int = 192
    height: int = 128

    def __post_init__(self) -> None:
        if self.first_seed < 0 or self.count < 1 or not 2 <= self.views <= 9 or min(self.width, self.height) < 32:
            raise BadRunError(f"found the clips {asdict(self)}", "seeds from 0, 2 to 9 views of 32 px or more")

    @property
    def seeds(self) -> range:
        """The clips' seeds."""
        return range(self.first_seed, self.first_seed + self.count)


@dataclass(frozen=True, eq=False)
class MultiviewClip:
    """The streams of the views, the plane looked at, and there the true `light` and `depth` [V, H, W] and cameras."""

    streams: tuple[SpikeStream, ...]
    plane: int
    light: NDArray[np.float32]  # spikes per tick
    depth: NDArray[np.float32]  # m along z; NaN where nothing is
    white: float
    rig: Rig


def make_clip(wanted: MultiviewSet, seed: int) -> MultiviewClip:
    """Render and expose the clip with `seed`."""
    rig = random_rig(seed, wanted.views, wanted.width, wanted.height)
    middle_s = rig.clock.instant_s(INSTANT)
    scene = multiview_scene(seed, rig.cameras[0].fx, middle_s)
    layout = PlaneLayout(wanted.width, wanted.height)
    streams, light, depth = [], [], []
    for number, camera in enumerate(rig.cameras):
        sensor = Sensor(wanted.width, wanted.height, "real", seed, number)
        packed = SceneSource(scene, camera, rig.clock, PLANES, sensor, layout).next_planes(PLANES)
        streams.append(SpikeStream(packed, layout, rig.tick_rate_hz))
        frames = scene.raycaster(camera, SAMPLES, 1).frames(*scene.placements(np.array([middle_s])))
        light.append(frames.intensity[0])
        depth.append(frames.depth[0])
    return MultiviewClip(tuple(streams), INSTANT, np.stack(light), np.stack(depth), scene.white, rig)


def write_clips(folder: Path, wanted: MultiviewSet, progress: Progress = silent) -> None:
    """Fill `folder` with the clips it lacks; raises BadRunError where it was begun for another set."""

    def arrays(seed: int) -> dict[str, NDArray]:
        clip = make_clip(wanted, seed)
        packed = np.stack([stream.packed for stream in clip.streams])
        light, white = clip.light.astype(np.float16), np.float64(clip.white)
        return {"packed": packed, "light": light, "depth": clip.depth, "white": np.asarray(white)}

    fill_folder(folder, {"schema": SCHEMA, **asdict(wanted)}, wanted.seeds, arrays, progress)


def read_clip_set(folder: Path) -> MultiviewSet:
    """What `folder` holds; raises BadRunError where it is no folder of such clips, or not whole."""
    found = read_document(folder)
    try:
        names = ("first_seed", "count", "views", "width", "height")
        wanted = MultiviewSet(*(int(found[name]) for name in names))
    except (KeyError, TypeError, ValueError) as error:
        raise BadRunError(
            f"found {found}", "clips of several views", "make them", where=f"{folder}/clips.json"
        ) from error
    require_whole(folder, found, SCHEMA, wanted.seeds)
    return wanted


def read_clip(folder: Path, wanted: MultiviewSet, seed: int) -> MultiviewClip:
    """The clip with `seed` out of `folder`."""
    rig, layout = random_rig(seed, wanted.views, wanted.width, wanted.height), PlaneLayout(wanted.width, wanted.height)
    with np.load(clip_path(folder, seed), allow_pickle=False) as archive:
        streams = tuple(SpikeStream(packed, layout, rig.tick_rate_hz) for packed in archive["packed"])
        light = archive["light"].astype(np.float32)
        return MultiviewClip(streams, INSTANT, light, archive["depth"], float(archive["white"]), rig)
