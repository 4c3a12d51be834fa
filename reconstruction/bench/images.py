"""Measures spikes to images: error against run time of every method over scenes, light levels and plane rates.

The measurements are cut into parts: decoding, each scene and seed, each published recording. With a work folder every
finished part is kept, and a stopped bench goes on after the last one.
"""

import itertools
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from acquisition.bench_document import BenchDocument
from acquisition.progress import Progress, silent
from acquisition.revision import code_revision
from acquisition.spikes.stream import SpikeStream
from reconstruction.bench.conventions import SLOWER, means, measure_parts, named
from reconstruction.bench.decoding import bench_decoding
from reconstruction.bench.scores import (
    CAR,
    DEFINITIONS,
    DIM,
    SYNTHETIC,
    TRUTH,
    Scorer,
    open_recording,
    score_recording,
    spikedata_folder,
)
from reconstruction.bench.streams import LitScene, Slowing, simulate_lights, slow_instant, slowed
from reconstruction.images.catalogue import Estimate, ImageMethod, methods
from rigs.errors import Spike4dgsError
from rigs.toml import catalog_rig

PLANES = 401
INSTANTS = (100, 200, 300)
MIDDLE = 200
LEVELS = (0.03, 0.1, 0.3, 1.6)  # factors of the scene's own light
WAYS: tuple[Slowing, ...] = ("drop", "reintegrate")
METHODS = methods()
Score = Callable[[NDArray[np.float32]], dict[str, float]]
SLOW_S = 1.0  # seconds an image from which a method sees other lights and rates in the first scene alone
AVERAGED = ("psnr_db", "ssim", "dynamic_psnr_db", "static_psnr_db", "edge_sharpness", "lpips", "brisque", "niqe")


@dataclass(frozen=True)
class Extent:
    """The scenes and seeds to measure; with `sweeps` also other lights, plane rates and published recordings."""

    scenes: tuple[str, ...]
    seeds: tuple[int, ...]
    sweeps: bool = True


class ImageBench:
    """Measures an `extent`, and keeps finished parts in `work`; `metric_files` is a folder of metrics' parameters."""

    def __init__(self, extent: Extent, work: Path | None = None, metric_files: Path | None = None) -> None:
        self._extent, self._work = extent, work
        self._scorer = Scorer(metric_files)
        self._rig = catalog_rig("lab3x3")

    def run(self, progress: Progress = silent) -> BenchDocument:
        """Measure every part that is not kept yet, and return the document of all."""
        extent = {"sweeps": self._extent.sweeps, "first": [self._extent.scenes[0], self._extent.seeds[0]]}
        key = {"revision": code_revision(), "methods": list(METHODS), "missing": list(self._scorer.omissions), **extent}
        document = measure_parts("images", self._parts(), self._work, progress, key)
        document.omissions = list(dict.fromkeys([*self._scorer.omissions, *document.omissions]))
        summarise(document)
        progress(1.0, f"{len(document.rows)} rows; {DEFINITIONS}")
        return document

    def _parts(self) -> dict[str, Callable[[BenchDocument], None]]:
        scenes = [(scene, seed) for seed in self._extent.seeds for scene in self._extent.scenes]
        files = (CAR, DIM, SYNTHETIC) if self._extent.sweeps else ()
        return {
            "decoding": self._decoding,
            **{f"{scene}-{seed}": partial(self._scene, scene=scene, seed=seed) for scene, seed in scenes},
            **{file: partial(self._recording, file=file) for file in files},
        }

    def _decoding(self, document: BenchDocument) -> None:
        scene, seed = self._extent.scenes[0], self._extent.seeds[0]
        bench_decoding(document, simulate_lights(scene, seed, self._rig, PLANES - 1, (1.0,)).streams[1.0])

    def _scene(self, document: BenchDocument, scene: str, seed: int) -> None:
        """Measure the scene's own light at full rate, and for the first seed other lights and rates."""
        sweeps = self._extent.sweeps and seed == self._extent.seeds[0]
        clip = simulate_lights(scene, seed, self._rig, PLANES, (1.0, *LEVELS) if sweeps else (1.0,))
        where = {"part": "scenes", "scene": scene, "seed": seed}
        full = {**where, "light": 1.0, "rate_hz": self._rig.tick_rate_hz, "rate_by": "full"}
        self._measure(document, full, clip.streams[1.0], INSTANTS, self._against(clip, INSTANTS))
        if not sweeps:
            return
        slow = frozenset(row["method"] for row in document.rows if row["seconds"] > SLOW_S)
        if scene == self._extent.scenes[0]:
            slow = frozenset()
        document.omissions += [
            f"{m}: other lights and rates only in {self._extent.scenes[0]}; an image takes longer than {SLOW_S:g} s"
            for m in slow
        ]
        for level in LEVELS:
            lit = {**full, "light": level}
            self._measure(document, lit, clip.streams[level], (MIDDLE,), self._against(clip, (MIDDLE,), level), slow)
        for how, k in itertools.product(WAYS, SLOWER):
            stream = slowed(clip.streams[1.0], k, how)
            plane, middle = slow_instant(MIDDLE, k, how)
            row = {**full, "rate_hz": stream.tick_rate_hz, "rate_by": how, "planes": len(stream)}
            self._measure(document, row, stream, (plane,), self._against(clip, (middle,)), slow)

    def _against(self, clip: LitScene, planes: Sequence[float], level: float = 1.0) -> list[Score]:
        return [partial(self._scorer.against, truth=truth) for truth in clip.truths(planes, level)]

    def _recording(self, document: BenchDocument, file: str) -> None:
        path = spikedata_folder() / file
        truth = path.with_name(TRUTH) if file == SYNTHETIC else None
        if not path.exists() or (truth and not truth.exists()):
            document.omissions.append(f"{file}: not found in $SPIKE4DGS_SHARED/spikedata")
            return
        stream, score = open_recording(path), partial(score_recording, self._scorer, truth=truth)
        self._measure(document, {"part": "recordings", "scene": file}, stream, (len(stream) // 2,), [score])

    def _measure(
        self,
        document: BenchDocument,
        row: dict,
        stream: SpikeStream,
        planes: Sequence[int],
        scores: Sequence[Score],
        without: frozenset[str] = frozenset(),
    ) -> None:
        """Add a row a method: means over the planes, the fastest of their times; a refusal is an omission."""
        for name, method in METHODS.items():
            if name in without:
                continue
            try:
                made = [timed(method, stream, plane) for plane in planes]
            except Spike4dgsError as error:
                where = f" on {row['scene']}" if row.get("part") == "recordings" else ""
                document.omissions.append(f"{name}{where}: {error}")
                continue
            found = [score(e.intensity) for (e, _), score in zip(made, scores, strict=True)]
            whole = {key: float(np.mean([each[key] for each in found])) for key in found[0]}
            valid = float(np.mean([e.valid.mean() for e, _ in made]))
            seconds = min(s for _, s in made)
            document.rows.append({"method": name, **row, **finite(whole), "valid": valid, "seconds": seconds})


def timed(method: ImageMethod, stream: SpikeStream, plane: int) -> tuple[Estimate, float]:
    """Return the image, and the seconds of the fastest of up to five calls that fit into a quarter of a second."""
    best, spent, calls = float("inf"), 0.0, 0
    while True:
        started = time.perf_counter()
        estimate = method(stream, plane)
        took = time.perf_counter() - started
        best, spent, calls = min(best, took), spent + took, calls + 1
        if calls == 5 or spent + took > 0.25:
            return estimate, best


def finite(values: dict[str, float]) -> dict[str, float]:
    """Return the values that JSON can hold; the score of an empty mask, or of equal images, is not finite."""
    return {key: value for key, value in values.items() if np.isfinite(value)}


def summarise(document: BenchDocument) -> None:
    """Add each method's means over scenes and seeds: as it is, by light, by rate, and on the synthetic recording."""
    rows = [row for row in document.rows if row.get("part") == "scenes"]
    for name in dict.fromkeys(row["method"] for row in rows):
        own = [row for row in rows if row["method"] == name]
        for light, rate_hz, how in dict.fromkeys((r["light"], r["rate_hz"], r["rate_by"]) for r in own):
            alike = [r for r in own if (r["light"], r["rate_hz"], r["rate_by"]) == (light, rate_hz, how)]
            if light == 1 and how == "full":
                document.summary |= named(name, means(alike, AVERAGED))
                seconds = float(np.median([r["seconds"] for r in alike]))
                document.summary[f"{name}.ms_per_image"] = 1e3 * seconds
            else:
                label = f"light{light:g}" if light != 1 else f"{how}{rate_hz:g}"
                document.summary |= named(name, means(alike, ("psnr_db",)), f"@{label}")
    for row in document.rows:
        if row.get("part") == "recordings" and row["scene"] == SYNTHETIC:
            document.summary |= named(f"{row['method']}.zoo", means([row], ("psnr_db", "ssim")))
