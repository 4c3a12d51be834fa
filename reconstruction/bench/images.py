"""Spikes to images: error against run time of every method over scenes, light levels and plane rates.

The measurements are cut into parts (decoding; each scene and seed; each real recording). With a work folder a finished
part is kept as a file of rows, and a stopped bench resumes behind it.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from acquisition.bench_document import BenchDocument
from acquisition.durable import write_json
from acquisition.progress import Progress, silent
from acquisition.revision import code_revision
from acquisition.spikes.stream import SpikeStream
from reconstruction.bench.clips import Clip, Slowing, Truth, simulate_clip, slow_instant, slowed
from reconstruction.bench.contact_sheet import write_strip
from reconstruction.bench.decoding import bench_decoding
from reconstruction.bench.recordings import (
    CAR,
    DIM,
    SYNTHETIC,
    TRUTH,
    open_recording,
    score_recording,
    spikedata_folder,
)
from reconstruction.bench.scores import DEFINITIONS, Scorer
from reconstruction.images.catalogue import ImageMethod, methods
from reconstruction.images.estimate import Estimate
from rigs.errors import Spike4dgsError
from rigs.toml import catalog_rig

PLANES = 401
INSTANTS = (100, 200, 300)
MIDDLE = 200
LEVELS = (0.03, 0.1, 0.3, 1.6)  # times the scene's own light
SLOWER = (2, 4, 10, 20, 40, 100, 200)  # 20 kHz down to 100 Hz
WAYS: tuple[Slowing, ...] = ("drop", "reintegrate")
METHODS = methods()
SLOW_S = 1.0  # an image; a slower method is not run at other lights and rates but in the first scene
AVERAGED = ("psnr_db", "ssim", "dynamic_psnr_db", "static_psnr_db", "edge_sharpness", "lpips", "brisque", "niqe")


@dataclass(frozen=True)
class Extent:
    """What is measured: scenes, the seeds of each, and whether other lights, plane rates and recordings are too."""

    scenes: tuple[str, ...]
    seeds: tuple[int, ...]
    sweeps: bool = True


class ImageBench:
    """Runs the parts of an `extent`; `metric_files` holds the parameters of metrics that need some."""

    def __init__(self, extent: Extent, work: Path | None = None, metric_files: Path | None = None) -> None:
        self._extent, self._work = extent, work
        self._scorer = Scorer.open(metric_files)
        self._rig = catalog_rig("lab3x3")

    def run(self, progress: Progress = silent) -> BenchDocument:
        """The document of all parts."""
        document = BenchDocument("images", omissions=[*self._scorer.omissions])
        parts = list(self._parts())
        for number, (name, measure) in enumerate(parts):
            progress(number / len(parts), name)
            self._kept(name, measure, document)
        document.omissions = list(dict.fromkeys(document.omissions))
        summarise(document)
        progress(1.0, f"{len(document.rows)} rows; {DEFINITIONS}")
        return document

    def _parts(self) -> Iterator[tuple[str, Callable[[BenchDocument], None]]]:
        first_scene, first_seed = self._extent.scenes[0], self._extent.seeds[0]
        yield "decoding", lambda document: self._decoding(document, first_scene, first_seed)
        for seed in self._extent.seeds:
            for scene in self._extent.scenes:
                yield f"{scene}-{seed}", lambda document, s=scene, n=seed: self._scene(document, s, n)
        if self._extent.sweeps:
            for file in (CAR, DIM, SYNTHETIC):
                yield file, lambda document, f=file: self._recording(document, f)

    def _kept(self, name: str, measure: Callable[[BenchDocument], None], document: BenchDocument) -> None:
        """Rows, omissions and summary of one part: from its file where this revision wrote one, else measured."""
        file = self._work / f"{name}.json" if self._work else None
        revision = code_revision()
        if file and file.exists():
            found = json.loads(file.read_text())
            if found["revision"] == revision and found["extent"] == self._key():
                document.rows += found["rows"]
                document.omissions += found["omissions"]
                document.summary |= found["summary"]
                return
        part = BenchDocument("images")
        measure(part)
        document.rows += part.rows
        document.omissions += part.omissions
        document.summary |= part.summary
        if file:
            file.parent.mkdir(parents=True, exist_ok=True)
            write_json(file, {"extent": self._key(), **part.to_json(), "summary": part.summary})

    def _key(self) -> dict:
        first = [self._extent.scenes[0], self._extent.seeds[0]]
        missing = list(self._scorer.omissions)
        return {"methods": list(METHODS), "sweeps": self._extent.sweeps, "first": first, "missing": missing}

    def _decoding(self, document: BenchDocument, scene: str, seed: int) -> None:
        bench_decoding(document, simulate_clip(scene, seed, self._rig, PLANES - 1, (1.0,)).streams[1.0])

    def _scene(self, document: BenchDocument, scene: str, seed: int) -> None:
        """The scene's own light at full rate; other lights and rates for the first seed alone."""
        sweeps = self._extent.sweeps and seed == self._extent.seeds[0]
        clip = simulate_clip(scene, seed, self._rig, PLANES, (1.0, *LEVELS) if sweeps else (1.0,))
        where = {"part": "scenes", "scene": scene, "seed": seed}
        full = {**where, "light": 1.0, "rate_hz": self._rig.tick_rate_hz, "rate_by": "full"}
        truths = clip.truths(INSTANTS)
        self._measure(document, full, clip.streams[1.0], INSTANTS, truths)
        if self._work and seed == self._extent.seeds[0]:
            write_strip(self._work / f"{scene}.png", scene, clip.streams[1.0], MIDDLE, truths[INSTANTS.index(MIDDLE)])
        if not sweeps:
            return
        slow = frozenset(row["method"] for row in document.rows if row["seconds"] > SLOW_S)
        if scene != self._extent.scenes[0]:
            document.omissions += [
                f"{m}: other lights and rates only in {self._extent.scenes[0]}; an image takes longer than {SLOW_S:g} s"
                for m in slow
            ]
        else:
            slow = frozenset()
        for level in LEVELS:
            lit = {**full, "light": level}
            self._measure(document, lit, clip.streams[level], (MIDDLE,), clip.truths((MIDDLE,), level), slow)
        self._rates(document, full, clip, slow)

    def _rates(self, document: BenchDocument, full: dict, clip: Clip, slow: frozenset[str]) -> None:
        for how in WAYS:
            for k in SLOWER:
                stream = slowed(clip.streams[1.0], k, how)
                plane, middle = slow_instant(MIDDLE, k, how)
                row = {**full, "rate_hz": stream.tick_rate_hz, "rate_by": how, "planes": len(stream)}
                self._measure(document, row, stream, (plane,), clip.truths((middle,)), slow)

    def _measure(
        self,
        document: BenchDocument,
        row: dict,
        stream: SpikeStream,
        instants: Sequence[int],
        truths: Sequence[Truth],
        without: frozenset[str] = frozenset(),
    ) -> None:
        """One row a method: means over the instants, the fastest of their times; a refusal is an omission."""
        for name, method in METHODS.items():
            if name in without:
                continue
            try:
                made = [timed(method, stream, plane) for plane in instants]
            except Spike4dgsError as error:
                document.omissions.append(f"{name}: {error}")
                continue
            scores = [self._scorer.against(e.intensity, t) for (e, _), t in zip(made, truths, strict=True)]
            means = {key: float(np.mean([score[key] for score in scores])) for key in scores[0]}
            valid = float(np.mean([e.valid.mean() for e, _ in made]))
            seconds = min(s for _, s in made)
            document.rows.append({"method": name, **row, **finite(means), "valid": valid, "seconds": seconds})

    def _recording(self, document: BenchDocument, file: str) -> None:
        path = spikedata_folder() / file
        truth = path.with_name(TRUTH) if file == SYNTHETIC else None
        if not path.exists() or (truth and not truth.exists()):
            document.omissions.append(f"{file}: not found in $SPIKE4DGS_SHARED/spikedata")
            return
        stream = open_recording(path)
        for name, method in METHODS.items():
            try:
                estimate, seconds = timed(method, stream, len(stream) // 2)
            except Spike4dgsError as error:
                document.omissions.append(f"{name} on {file}: {error}")
                continue
            scores = finite(score_recording(self._scorer, estimate.intensity, truth))
            row = {"part": "recordings", "method": name, "scene": file, **scores}
            document.rows.append({**row, "valid": float(estimate.valid.mean()), "seconds": seconds})


def timed(method: ImageMethod, stream: SpikeStream, plane: int) -> tuple[Estimate, float]:
    """The image and its seconds: the fastest of up to five calls, as many as fit into a quarter of a second."""
    best, spent, calls = float("inf"), 0.0, 0
    while True:
        started = time.perf_counter()
        estimate = method(stream, plane)
        took = time.perf_counter() - started
        best, spent, calls = min(best, took), spent + took, calls + 1
        if calls == 5 or spent + took > 0.25:
            return estimate, best


def finite(values: dict[str, float]) -> dict[str, float]:
    """Without what JSON cannot hold: the score of an empty mask or of equal images."""
    return {key: value for key, value in values.items() if np.isfinite(value)}


def summarise(document: BenchDocument) -> None:
    """Means by method over scenes and seeds: at full rate and light, at each light, at each rate, on the synthetic."""
    rows = [row for row in document.rows if row.get("part") == "scenes"]
    for name in dict.fromkeys(row["method"] for row in rows):
        own = [row for row in rows if row["method"] == name]
        full = [row for row in own if row["light"] == 1 and row["rate_by"] == "full"]
        for key in AVERAGED:
            values = [row[key] for row in full if key in row]
            if values:
                document.summary[f"{name}.{key}"] = float(np.mean(values))
        document.summary[f"{name}.ms_per_image"] = 1e3 * float(np.median([row["seconds"] for row in full]))
        for row in own:
            if row not in full:
                label = f"light{row['light']:g}" if row["light"] != 1 else f"{row['rate_by']}{row['rate_hz']:g}"
                alike = [r for r in own if all(r[k] == row[k] for k in ("light", "rate_hz", "rate_by"))]
                values = [r["psnr_db"] for r in alike if "psnr_db" in r]
                if values:
                    document.summary[f"{name}.psnr_db@{label}"] = float(np.mean(values))
    for row in document.rows:
        if row.get("part") == "recordings" and row["scene"] == SYNTHETIC:
            document.summary |= {f"{row['method']}.zoo.{key}": row[key] for key in ("psnr_db", "ssim") if key in row}
