"""A scene that a path tracer draws, seen by any camera; what was drawn once is read from the cache."""

from __future__ import annotations

import functools
import hashlib
import inspect
import json
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from acquisition.errors import BadRecordingError
from acquisition.progress import Progress, silent
from acquisition.scenes.motion import Floats, Vector
from acquisition.scenes.realistic.cache import LightCache, camera_digest
from acquisition.scenes.realistic.library import versions
from acquisition.scenes.realistic.setting import FIRST_S, KEYFRAME_S, KEYFRAMES, LASTS_S, Setting
from acquisition.scenes.realistic.studio import CHUNK, Studio, chunks_of
from acquisition.scenes.view import Frames
from rigs.camera import Camera

Build = Callable[[int], Setting]
WHITE, CENTER = 0.6, (0.0, 0.0, 1.9)  # of every such scene: spikes per tick, metres
_DRAWING = ("meshes", "setting", "pictures", "physics", "painter", "rays", "surfaces", "passed_on", "settled", "studio")
LENS = b"# lens\n"  # ends lines of code that change nothing for cameras whose lenses do not bend
_one_at_a_time = threading.RLock()  # nine simulated cameras ask at once


@dataclass(frozen=True, eq=False)
class DrawnScene:
    """The setting that `build` makes of `seed`, in `level` times its light, going on for `begins_s` at instant 0.

    Its clip ends LASTS_S after the trigger. Light is drawn at keyframes, each a middle of every fourth plane of 20 kHz,
    and runs straight between them; things move by less than a third of a pixel a plane. `moved_by` are the modules of
    `acquisition.scenes` that decide how, beside the one of `build`.
    """

    name: str
    seed: int
    build: Build
    level: float = 1.0
    begins_s: float = 0.0
    moved_by: tuple[str, ...] = ()

    @property
    def white(self) -> float:
        """The light that is shown as white."""
        return WHITE * self.level

    @property
    def center(self) -> Vector:
        """The point the scene happens around."""
        return CENTER

    @property
    def setting(self) -> Setting:
        """All that stands before the cameras."""
        return _setting(self.build, self.seed)

    @property
    def object_ids(self) -> dict[str, int]:
        """The object id of each body by name."""
        return self.setting.object_ids

    @property
    def movers(self) -> dict[str, int]:
        """The object ids of the bodies that move, by name."""
        return self.setting.movers

    @functools.cached_property
    def digest(self) -> str:
        """The SHA-256 of all that decides what pinholes see: the code, the versions of the packages, the seed."""
        return self._digest(_DRAWING, lambda line: not line.endswith(LENS))

    @functools.cached_property
    def bent_digest(self) -> str:
        """The SHA-256 of all that decides what cameras see whose lenses bend."""
        return self._digest((*_DRAWING, "bent"), lambda line: True)

    def _digest(self, names: Sequence[str], counts: Callable[[bytes], bool]) -> str:
        folder = Path(__file__).parent
        sources = [folder / f"{name}.py" for name in names] + [Path(inspect.getfile(self.build))]
        sources += [folder.parent / f"{name}.py" for name in self.moved_by]
        found = hashlib.sha256(json.dumps([self.name, self.seed, versions()], sort_keys=True).encode())
        for source in sources:
            found.update(b"".join(filter(counts, source.read_bytes().splitlines(keepends=True))))
        return found.hexdigest()

    def lit(self, factor: float) -> Self:
        """Return the same scene in `factor` times its light."""
        return replace(self, level=self.level * factor)

    def since(self, begins_s: float) -> Self:
        """Return the scene as it is where it has been going on for `begins_s` at the instant 0."""
        return replace(self, begins_s=begins_s)

    def view(self, camera: Camera, samples: int, threads: int = 0) -> DrawnView:
        """Return what `camera` sees; how many rays a pixel has is the studio's choice, not that of `samples`."""
        return DrawnView(self, camera)

    def render(self, camera: Camera, instants_s: Floats, samples: int = 4) -> Frames:
        """Return the frames that `camera` sees at `instants_s` [n]."""
        return self.view(camera, samples).frames(instants_s)

    def prepare(self, cameras: Sequence[Camera], last_s: float, progress: Progress = silent) -> None:
        """Draw what the cameras see until `last_s` on the rig clock, and the cache lacks; a stopped one goes on."""
        views = [DrawnView(self, camera) for camera in cameras]
        last = min(last_s + self.begins_s, LASTS_S)
        chunks = list(chunks_of(*_around(np.array([self.begins_s, last]))))
        lacking = [(chunk, [view for view in views if not view.has(chunk)]) for chunk in chunks]
        lacking = [(chunk, some) for chunk, some in lacking if some]
        started_s = time.monotonic()
        for done, (chunk, some) in enumerate(lacking):
            left_s = (time.monotonic() - started_s) / max(done, 1) * (len(lacking) - done)
            said = f", {left_s:.0f} s left" if done else ""
            progress(done / len(lacking), f"light of {self.name}, part {done + 1} of {len(lacking)}{said}")
            draw(self, some, chunk)

    def description(self) -> dict[str, Any]:
        """Return what `truth/scene.json` says of the scene: bodies, and how it was drawn."""
        movers = [{"id": number, "name": name} for name, number in self.movers.items()]
        drawn = {"digest": self.digest, "keyframe_s": KEYFRAME_S, **versions()}
        return {"object_ids": self.object_ids, "movers": movers, "light": {"drawn": drawn}}


class DrawnView:
    """One camera before a drawn scene."""

    def __init__(self, scene: DrawnScene, camera: Camera):
        self.camera = camera
        self._scene = scene
        self._cache = LightCache(scene.bent_digest if camera.bends else scene.digest, camera)
        self._read: dict[int, NDArray] = {}

    def has(self, chunk: int) -> bool:
        """Return whether the keyframes of `chunk` are in the cache."""
        return self._cache.has(_chunk_name(chunk))

    def keep(self, chunk: int, light: NDArray[np.float32]) -> None:
        """Store the light of a chunk's keyframes."""
        self._cache.write(_chunk_name(chunk), light.astype(np.float16))

    def light(self, instants_s: Floats) -> NDArray[np.float32]:
        """Return the linear light at `instants_s` [n], in spikes per tick [n, H, W], straight between keyframes.

        Raises BadRecordingError for an instant outside the clip.
        """
        instants_s = np.asarray(instants_s, dtype=np.float64) + self._scene.begins_s
        low = np.minimum(_places(instants_s).astype(int), KEYFRAMES - 2)
        share = (_places(instants_s) - low).astype(np.float32)
        found = np.empty((len(instants_s), self.camera.height, self.camera.width), dtype=np.float32)
        for number, (keyframe, part) in enumerate(zip(low, share, strict=True)):
            found[number] = (1 - part) * self._frame(keyframe) + part * self._frame(keyframe + 1)
        return found if self._scene.level == 1 else found * np.float32(self._scene.level)

    def frames(self, instants_s: Floats) -> Frames:
        """Return light, depth and objects at `instants_s` [n]; the light is drawn until its noise is small."""
        places_s = [float(instant_s) + self._scene.begins_s for instant_s in instants_s]
        depth, ids = (np.stack(images) for images in zip(*map(self._look, places_s), strict=True))
        light = np.stack([self._true_light(place_s) for place_s in places_s])
        return Frames(light if self._scene.level == 1 else light * np.float32(self._scene.level), depth, ids)

    def _frame(self, keyframe: int) -> NDArray[np.float32]:
        chunk = keyframe // CHUNK
        if chunk not in self._read:
            if not self.has(chunk):
                draw(self._scene, [self], chunk)
            self._read = dict(list(self._read.items())[-1:])  # two chunks at a time, one before the other
            self._read[chunk] = self._cache.read(_chunk_name(chunk))
        return self._read[chunk][keyframe % CHUNK].astype(np.float32)

    def _true_light(self, instant_s: float) -> NDArray[np.float32]:
        name = f"true_{round(instant_s * 1e9)}"
        if not self._cache.has(name):
            with _one_at_a_time:
                light = _studio(self._scene.build, self._scene.seed).true_light(self.camera, instant_s)
            self._cache.write(name, light.astype(np.float16))
        return self._cache.read(name).astype(np.float32)

    def _look(self, instant_s: float) -> tuple[NDArray[np.float32], NDArray[np.int8]]:
        _places(np.array([instant_s]))
        names = [f"{kind}_{round(instant_s * 1e9)}" for kind in ("depth", "id")]
        if not all(map(self._cache.has, names)):
            with _one_at_a_time:
                looked = _studio(self._scene.build, self._scene.seed).look(self.camera, instant_s)
            for name, array in zip(names, looked, strict=True):
                self._cache.write(name, array)
        depth, ids = (np.array(self._cache.read(name)) for name in names)
        return depth, ids


def draw(scene: DrawnScene, views: Sequence[DrawnView], chunk: int) -> None:
    """Draw the keyframes of a chunk for the views that lack them, and store them."""
    with _one_at_a_time:
        lacking = {camera_digest(view.camera): view for view in views if not view.has(chunk)}
        if lacking:
            drawn = _studio(scene.build, scene.seed).draw([view.camera for view in lacking.values()], chunk)
            for view, light in zip(lacking.values(), drawn, strict=True):
                view.keep(chunk, light)


@functools.lru_cache(maxsize=2)
def _setting(build: Build, seed: int) -> Setting:
    return build(seed)


@functools.lru_cache(maxsize=1)
def _studio(build: Build, seed: int) -> Studio:
    return Studio(_setting(build, seed))


def _places(instants_s: Floats) -> Floats:
    """Return where instants lie among the keyframes; raises BadRecordingError for one outside the clip."""
    places = (instants_s - FIRST_S) / KEYFRAME_S
    if len(places) and not -1e-6 <= places.min() <= places.max() <= KEYFRAMES - 1 + 1e-6:
        wrong = instants_s[np.argmax(np.abs(places - KEYFRAMES / 2))]
        expected = f"{FIRST_S:.3f} to {LASTS_S:g} s, for which the scene is drawn"
        raise BadRecordingError(f"found the instant {wrong:.4f} s", expected, "record fewer ticks")
    return np.clip(places, 0, KEYFRAMES - 1)


def _around(span_s: Floats) -> tuple[int, int]:
    first, last = _places(span_s)
    return int(first), int(np.ceil(last))


def _chunk_name(chunk: int) -> str:
    return f"light_{chunk:04d}"
