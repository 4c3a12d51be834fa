"""Clips of random scenes to train on: packed planes and the true light at a few instants, one file a clip.

`clips.json` says what the folder holds; a killed generator goes on where it stopped. Every clip's seed is its number:
the scene, the sensor's pixels and its noise all follow from it, so a folder can be made again byte for byte.
"""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from acquisition.durable import write_durably, write_json
from acquisition.progress import Progress, silent
from acquisition.scenes.random import random_camera, random_scene
from acquisition.scenes.source import SceneSource
from acquisition.spikes.layout import PlaneLayout
from acquisition.spikes.sensor import Sensor
from acquisition.spikes.stream import SpikeStream
from reconstruction.errors import BadRunError
from rigs.clock import RigClock

SCHEMA = 1
TICK_RATE_HZ = 20000.0
IDEAL_EVERY = 8  # one clip of so many has the ideal sensor, the others the real one
SAMPLES = 4  # rays a side of a pixel in the truth


@dataclass(frozen=True)
class ClipSet:
    """Clips with the seeds `first_seed` ... `first_seed + count - 1`, `size` x `size` pixels, truth at `instants`."""

    first_seed: int
    count: int
    size: int = 96
    planes: int = 161
    instants: tuple[int, ...] = (64, 80, 96)

    def __post_init__(self) -> None:
        if self.first_seed < 0 or self.count < 1 or self.size < 8 or self.planes < 1 or not self.instants:
            raise BadRunError(f"found the clips {asdict(self)}", "seeds from 0, 8 px or more, some instants")
        if not 0 <= min(self.instants) <= max(self.instants) < self.planes:
            raise BadRunError(f"found the instants {self.instants}", f"planes inside 0:{self.planes}")

    @property
    def seeds(self) -> range:
        """The clips' seeds."""
        return range(self.first_seed, self.first_seed + self.count)


@dataclass(frozen=True, eq=False)
class Clip:
    """One clip: its planes, and the true light [n, H, W] in spikes per tick at the planes `instants` [n]."""

    stream: SpikeStream
    instants: tuple[int, ...]
    truth: NDArray[np.float32]


def make_clip(wanted: ClipSet, seed: int) -> Clip:
    """Render and expose the clip with `seed`."""
    clock = RigClock(TICK_RATE_HZ)
    camera, layout = random_camera(wanted.size, wanted.size), PlaneLayout(wanted.size, wanted.size)
    scene = random_scene(seed, clock.instant_s(wanted.instants[len(wanted.instants) // 2]), wanted.size)
    sensor = Sensor(wanted.size, wanted.size, "real" if seed % IDEAL_EVERY else "ideal", seed, 0)
    packed = SceneSource(scene, camera, clock, wanted.planes, sensor, layout).next_planes(wanted.planes)
    instants_s = np.array([clock.instant_s(k) for k in wanted.instants])
    truth = scene.raycaster(camera, SAMPLES, 1).intensity(*scene.placements(instants_s))
    return Clip(SpikeStream(packed, layout, TICK_RATE_HZ), wanted.instants, truth)


def write_clips(folder: Path, wanted: ClipSet, progress: Progress = silent) -> None:
    """Fill `folder` with the clips it lacks; raises BadRunError where it was begun for another set."""
    document = {"schema": SCHEMA, **asdict(wanted), "instants": list(wanted.instants)}

    def arrays(seed: int) -> dict[str, NDArray]:
        clip = make_clip(wanted, seed)
        return {"packed": clip.stream.packed, "truth": clip.truth}

    fill_folder(folder, document, wanted.seeds, arrays, progress)


def fill_folder(
    folder: Path, document: dict, seeds: range, arrays_of: Callable[[int], dict[str, NDArray]], progress: Progress
) -> None:
    """Write `arrays_of` each of `seeds` that `folder` lacks; raises BadRunError where `clips.json` is another one."""
    folder.mkdir(parents=True, exist_ok=True)
    if (folder / "clips.json").exists():
        if (found := read_document(folder)) != document:
            raise BadRunError(f"found clips {found}", f"{document}", "give a new folder", where=folder)
    else:
        write_json(folder / "clips.json", document)
    lacking = [seed for seed in seeds if not clip_path(folder, seed).exists()]
    for done, seed in enumerate(lacking, 1):
        buffer = io.BytesIO()
        np.savez(buffer, **arrays_of(seed))  # pyright: ignore[reportArgumentType]
        write_durably(clip_path(folder, seed), buffer.getvalue())
        progress(done / len(lacking), f"clip {seed}")


def require_whole(folder: Path, document: dict, schema: int, seeds: range) -> None:
    """Raises BadRunError where `document` is of another schema or clips of `seeds` are missing."""
    lacking = sum(not clip_path(folder, seed).exists() for seed in seeds)
    if lacking or document.get("schema") != schema:
        raise BadRunError(f"found {lacking} clips missing of {len(seeds)}", do="run the generator again", where=folder)


def read_clip_set(folder: Path) -> ClipSet:
    """What `folder` holds; raises BadRunError where it is no folder of clips of this version, or not whole."""
    found = read_document(folder)
    try:
        first_seed, count, size, planes = (int(found[name]) for name in ("first_seed", "count", "size", "planes"))
        wanted = ClipSet(first_seed, count, size, planes, tuple(found["instants"]))
    except (KeyError, TypeError, ValueError) as error:
        raise BadRunError(f"found {found}", "a set of clips", "make it again", where=f"{folder}/clips.json") from error
    require_whole(folder, found, SCHEMA, wanted.seeds)
    return wanted


def read_clip(folder: Path, wanted: ClipSet, seed: int) -> Clip:
    """The clip with `seed` out of `folder`."""
    with np.load(clip_path(folder, seed), allow_pickle=False) as archive:
        stream = SpikeStream(archive["packed"], PlaneLayout(wanted.size, wanted.size), TICK_RATE_HZ)
        return Clip(stream, wanted.instants, archive["truth"].astype(np.float32))


def clip_path(folder: Path, seed: int) -> Path:
    """The file of the clip with `seed`."""
    return folder / f"{seed:07d}.npz"


def read_document(folder: Path) -> dict:
    """What `clips.json` of `folder` says; raises BadRunError where there is none."""
    try:
        return json.loads((folder / "clips.json").read_text())
    except (OSError, ValueError) as error:
        raise BadRunError("found no readable clips.json", "a folder of clips", "make them", where=folder) from error
