"""Clips of random scenes to train on, one file each: of one camera for image networks, of several views for MSDI.

`clips.json` says what a folder holds; a killed generator goes on where it stopped. A clip's seed is its number: scene,
cameras, the sensor's pixels and its noise all follow from it, so a folder can be made again byte for byte.
Letters: V views, n instants, H rows, W columns.
"""

import io
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import ClassVar, TypeVar

import numpy as np
from numpy.typing import NDArray

from acquisition.arrays import read_arrays
from acquisition.durable import write_durably, write_json
from acquisition.progress import Progress, silent
from acquisition.scenes.own import AS_NOMINAL, Own
from acquisition.scenes.random.clutter import random_camera, random_scene
from acquisition.scenes.random.rooms import Room
from acquisition.scenes.random.several_views import multiview_scene, random_own, random_rig
from acquisition.scenes.source import SceneSource
from acquisition.scenes.view import Visible
from acquisition.spikes.layout import PlaneLayout
from acquisition.spikes.sensor import Sensor
from acquisition.spikes.stream import SpikeStream
from reconstruction.errors import BadRunError
from reconstruction.networks.rates import REACH
from rigs.camera import Camera
from rigs.clock import RigClock
from rigs.rig import Rig

SCHEMA = 1
TICK_RATE_HZ = 20000.0
IDEAL_EVERY = 8  # clips of one camera, of which one has the ideal sensor and the others the real one
VIEW_KINDS = ("clutter", "photographs", "rooms")  # of scenes; all but the first need the extra `realistic`
CLIP_RAYS, VIEW_RAYS = 4, 3  # rays a side of a pixel in the truth of a clip of one camera, of several views


@dataclass(frozen=True)
class ClipSet:
    """Clips with the seeds `first_seed` ... `first_seed + count - 1`, as `clips.json` describes them."""

    noun: ClassVar[str] = "clips"
    first_seed: int
    count: int

    @property
    def seeds(self) -> range:
        """Return the clips' seeds."""
        return range(self.first_seed, self.first_seed + self.count)

    def path(self, folder: Path, seed: int) -> Path:
        """Return the file of the clip with `seed`."""
        return folder / f"{seed:07d}.npz"


Kind = TypeVar("Kind", bound=ClipSet)


@dataclass(frozen=True, eq=False)
class CameraClip:
    """One camera's planes, and the true light [n, H, W] in spikes per tick at the planes `instants` [n]."""

    stream: SpikeStream
    instants: tuple[int, ...]
    truth: NDArray[np.float32]


@dataclass(frozen=True)
class CameraClips(ClipSet):
    """Clips of one camera of `size` x `size` pixels over `planes`, with the true light at `instants`."""

    noun: ClassVar[str] = "clips of one camera"
    size: int = 96
    planes: int = 161
    instants: tuple[int, ...] = (64, 80, 96)

    def __post_init__(self) -> None:
        object.__setattr__(self, "instants", tuple(self.instants))  # JSON has lists
        if self.first_seed < 0 or self.count < 1 or self.size < 8 or self.planes < 1 or not self.instants:
            raise BadRunError(f"found the clips {asdict(self)}", "seeds from 0, 8 px or more, some instants")
        if not 0 <= min(self.instants) <= max(self.instants) < self.planes:
            raise BadRunError(f"found the instants {self.instants}", f"planes inside 0:{self.planes}")

    def make(self, seed: int) -> CameraClip:
        """Render and expose the clip with `seed`."""
        clock = RigClock(TICK_RATE_HZ)
        camera = random_camera(self.size, self.size)
        scene = random_scene(seed, clock.instant_s(self.instants[len(self.instants) // 2]), self.size)
        sensor = Sensor(self.size, self.size, "real" if seed % IDEAL_EVERY else "ideal", seed, 0)
        instants_s = np.array([clock.instant_s(k) for k in self.instants])
        truth = scene.view(camera, CLIP_RAYS, 1).light(instants_s)
        return CameraClip(exposed(scene, camera, clock, self.planes, sensor), self.instants, truth)

    def arrays(self, seed: int) -> Mapping[str, NDArray]:
        """Make the clip with `seed` and return what its file holds."""
        clip = self.make(seed)
        return {"packed": clip.stream.packed, "truth": clip.truth}

    def read(self, folder: Path, seed: int) -> CameraClip:
        """Read the clip with `seed` out of `folder`."""
        arrays = read_arrays(self.path(folder, seed))
        stream = SpikeStream(arrays["packed"], PlaneLayout(self.size, self.size), TICK_RATE_HZ)
        return CameraClip(stream, self.instants, arrays["truth"].astype(np.float32))


@dataclass(frozen=True, eq=False)
class MultiviewClip:
    """The streams of V views around `plane`, and what is true there.

    `light` [V, H, W] in spikes per tick, `depth` [V, H, W] in m along z (NaN where nothing is), `white` in spikes per
    tick, and the cameras.
    """

    streams: tuple[SpikeStream, ...]
    plane: int
    light: NDArray[np.float32]
    depth: NDArray[np.float32]
    white: float
    rig: Rig


@dataclass(frozen=True)
class MultiviewClips(ClipSet):
    """Clips of `views` cameras of `width` x `height` px, with truth at the middle plane, of the `kinds` in turns.

    The truth is what each camera has at its own gain and lag.
    """

    noun: ClassVar[str] = "clips of several views"
    views: int = 4
    width: int = 192
    height: int = 128
    kinds: tuple[str, ...] = ("clutter",)

    def __post_init__(self) -> None:
        object.__setattr__(self, "kinds", tuple(self.kinds))  # JSON has lists
        if self.first_seed < 0 or self.count < 1 or not 2 <= self.views <= 9 or min(self.width, self.height) < 32:
            raise BadRunError(f"found the clips {asdict(self)}", "seeds from 0, 2 to 9 views of 32 px or more")
        if not self.kinds or set(self.kinds) - set(VIEW_KINDS):
            raise BadRunError(f"found clips of the kinds {self.kinds}", f"some of {', '.join(VIEW_KINDS)}")

    def kind(self, seed: int) -> str:
        """Return the kind of the scene of the clip with `seed`."""
        return self.kinds[seed % len(self.kinds)]

    def make(self, seed: int) -> MultiviewClip:
        """Render and expose the clip with `seed`; raises MissingRendererError for a kind that needs the extra."""
        rig = random_rig(seed, self.views, self.width, self.height)
        middle_s = rig.clock.instant_s(REACH)
        scene = self._scene(seed, rig, middle_s)
        streams, light, depth = [], [], []
        for number, (camera, own) in enumerate(zip(rig.cameras, random_own(seed, self.views), strict=True)):
            sensor = Sensor(self.width, self.height, "real", seed, number)
            streams.append(exposed(scene, camera, rig.clock, 2 * REACH + 1, sensor, own))
            frames = scene.view(camera, VIEW_RAYS, 1).frames(np.array([middle_s + own.lag_ticks / rig.tick_rate_hz]))
            light.append(np.float32(own.gain) * frames.intensity[0])
            depth.append(frames.depth[0])
        return MultiviewClip(tuple(streams), REACH, np.stack(light), np.stack(depth), scene.white, rig)

    def _scene(self, seed: int, rig: Rig, middle_s: float) -> Visible:
        if self.kind(seed) == "rooms":
            return Room(seed, rig.cameras[0], middle_s)
        return multiview_scene(seed, rig.cameras[0].fx, middle_s, photographed=self.kind(seed) == "photographs")

    def arrays(self, seed: int) -> Mapping[str, NDArray]:
        """Make the clip with `seed` and return what its file holds."""
        clip = self.make(seed)
        packed, white = np.stack([stream.packed for stream in clip.streams]), np.asarray(np.float64(clip.white))
        return {"packed": packed, "light": clip.light.astype(np.float16), "depth": clip.depth, "white": white}

    def read(self, folder: Path, seed: int) -> MultiviewClip:
        """Read the clip with `seed` out of `folder`."""
        rig, layout = random_rig(seed, self.views, self.width, self.height), PlaneLayout(self.width, self.height)
        arrays = read_arrays(self.path(folder, seed))
        streams = tuple(SpikeStream(packed, layout, rig.tick_rate_hz) for packed in arrays["packed"])
        light, white = arrays["light"].astype(np.float32), float(arrays["white"])
        return MultiviewClip(streams, REACH, light, arrays["depth"], white, rig)


def exposed(
    scene: Visible, camera: Camera, clock: RigClock, planes: int, sensor: Sensor, own: Own = AS_NOMINAL
) -> SpikeStream:
    """Return the first `planes` that `sensor` records where `camera`, of its `own` gain and lag, looks at `scene`."""
    layout = PlaneLayout(camera.width, camera.height)
    packed = SceneSource(scene, camera, clock, planes, sensor, layout, own=own).next_planes(planes)
    return SpikeStream(packed, layout, clock.tick_rate_hz)


def write_clips(folder: Path, wanted: CameraClips | MultiviewClips, progress: Progress = silent) -> None:
    """Fill `folder` with the clips it lacks; raises BadRunError where it was begun for another set."""
    folder.mkdir(parents=True, exist_ok=True)
    document = json.loads(json.dumps({"schema": SCHEMA, **asdict(wanted)}))
    if not (folder / "clips.json").exists():
        write_json(folder / "clips.json", document)
    elif (found := _read_document(folder)) != document:
        raise BadRunError(f"found clips {found}", f"{document}", "give a new folder", where=folder)
    lacking = [seed for seed in wanted.seeds if not wanted.path(folder, seed).exists()]
    for done, seed in enumerate(lacking, 1):
        buffer = io.BytesIO()
        np.savez(buffer, **wanted.arrays(seed))  # pyright: ignore[reportArgumentType]
        write_durably(wanted.path(folder, seed), buffer.getvalue())
        progress(done / len(lacking), f"clip {seed}")


def read_clip_set(folder: Path, kind: type[Kind]) -> Kind:
    """Return the clips of `kind` in `folder`; raises BadRunError where others are there, or not all of them."""
    found = _read_document(folder)
    try:
        wanted = kind(**{field.name: found[field.name] for field in fields(kind)})
    except (KeyError, TypeError, ValueError) as error:
        raise BadRunError(f"found {found}", kind.noun, "make them", where=f"{folder}/clips.json") from error
    lacking = sum(not wanted.path(folder, seed).exists() for seed in wanted.seeds)
    if lacking or found.get("schema") != SCHEMA:
        raise BadRunError(f"found {lacking} clips missing of {wanted.count}", do="make the rest", where=folder)
    return wanted


def _read_document(folder: Path) -> dict:
    try:
        return json.loads((folder / "clips.json").read_text())
    except (OSError, ValueError) as error:
        raise BadRunError("found no readable clips.json", "a folder of clips", "make them", where=folder) from error
