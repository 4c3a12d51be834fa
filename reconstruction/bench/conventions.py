"""Holds what all benches share: recordings, the held-out camera, views, plane rates, the cache, fresh processes."""

import json
import multiprocessing
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from acquisition.bench_document import BenchDocument, machines_of, revisions_of
from acquisition.durable import write_json
from acquisition.progress import Progress
from acquisition.recording.reader import Recording
from acquisition.scenes.catalog import (
    BACKGROUNDS,
    DEVELOPMENT,
    DEVELOPMENT_SEEDS,
    EVALUATION_SEEDS,
    LONG_DEVELOPMENT,
    REALISTIC,
    REALISTIC_LONG,
)
from reconstruction.calibration.features import long_image
from reconstruction.errors import BadRunError, ReconstructionError
from reconstruction.truth import Truth, TruthFrame
from rigs.rig import Rig
from rigs.toml import catalog_rig

Result = TypeVar("Result")
HOLDOUT = "cam11"
RATE_HZ = 20000
SLOWER = (2, 4, 10, 20, 40, 100, 200)  # factors between RATE_HZ and the slower plane rates: 10 kHz down to 100 Hz


_CENTERS = {camera.id: camera.center for camera in catalog_rig("lab3x3").cameras}
_AWAY_M = {name: float(np.linalg.norm(center - _CENTERS[HOLDOUT]).round(6)) for name, center in _CENTERS.items()}
VIEWS = tuple(sorted(_AWAY_M, key=_AWAY_M.__getitem__)[1:])  # all cameras but HOLDOUT, the nearest to it first


def seed_of(scene: str, number: int = 0) -> int:
    """Return a scene's seed by its number; benches use number 0 where they name none."""
    developed = scene in (*DEVELOPMENT, *BACKGROUNDS, *REALISTIC, *LONG_DEVELOPMENT, *REALISTIC_LONG)
    seeds = (*DEVELOPMENT_SEEDS[1:], DEVELOPMENT_SEEDS[0]) if developed else EVALUATION_SEEDS
    return seeds[number]


@dataclass(frozen=True)
class KnownRecording:
    """A simulated recording in the folder `path`, whose scene and truth are known."""

    scene: str
    seed: int
    path: Path

    @cached_property
    def recording(self) -> Recording:
        """The recording; opened on first use."""
        return Recording.open(self.path)

    @cached_property
    def truth(self) -> Truth:
        """The truth of the recording; raises BadRunError where it has none."""
        return truth_of(self.recording)

    @cached_property
    def middle(self) -> TruthFrame:
        """The truth of the held-out camera in the middle of the recording."""
        planes = self.truth.planes(HOLDOUT)
        return self.truth.frame(HOLDOUT, planes[len(planes) // 2])

    @cached_property
    def rig(self) -> Rig:
        """The cameras where they truly stand."""
        found = self.truth.cameras(self.recording.tick_rate_hz)
        if found is None:
            raise BadRunError("found no cameras in the truth", "cameras.json", where=self.path)
        return found.only(self.recording.camera_ids)

    @cached_property
    def long_images(self) -> dict[str, NDArray[np.float32]]:
        """The long-window image [H, W] of every camera, in spikes per tick."""
        return {c: long_image(self.recording.stream(c)) for c in self.recording.camera_ids}


def made_by(document: dict, against: str = "") -> str:
    """Return the line of a page that says which command, revision and machine made its document, and which its rows."""
    name, rows = document["bench"], document["rows"]
    made = f"`spike4dgs bench {name}`, {revisions_of(document, [])}{against}, {machines_of(document, [])}"
    older = any(of(document, rows) != of(document, []) for of in (revisions_of, machines_of))
    from_rows = f"; rows of {revisions_of(document, rows)}, {machines_of(document, rows)}" if older else ""
    return f"{made}{from_rows}; drawn from [{name}.json]({name}.json)."


def truth_of(recording: Recording) -> Truth:
    """Open the truth of a recording; raises BadRunError where it has none."""
    if recording.truth is None:
        raise BadRunError("found no truth", "a simulated recording to score against", where=recording.path)
    return Truth.open(recording.truth)


def kept(file: Path | None, measure: Callable[[], dict], key: Mapping[str, object] | None = None) -> dict:
    """Return the result of `measure`, from `file` where an earlier call with an equal `key` left it.

    A new result is written to `file`, unless that is None. Results and keys can be written as JSON.
    """
    wanted = json.loads(json.dumps(dict(key or {})))
    if file and file.exists():
        found = json.loads(file.read_text())
        if found.get("key") == wanted:
            return found["result"]
    result = measure()
    if file:
        file.parent.mkdir(parents=True, exist_ok=True)
        write_json(file, {"key": wanted, "result": result})
    return result


def in_time(time_left: Callable[[], bool], measure: Callable[[], dict]) -> Callable[[], dict]:
    """Return `measure` that is refused without `time_left`; raises ReconstructionError then."""

    def begun() -> dict:
        if not time_left():
            raise ReconstructionError("no time was left")
        return measure()

    return begun


def apart(work: Callable[[], Result]) -> Result:
    """Call `work` in a fresh process and return its result."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        return pool.apply(work)


def measure_parts(
    bench: str,
    parts: Mapping[str, Callable[[BenchDocument], None]],
    work: Path | None,
    progress: Progress,
    key: Mapping[str, object] | None = None,
) -> BenchDocument:
    """Return the document of all parts; one that `work` has with an equal `key` is not measured again.

    A part adds rows, omissions and summary to an empty document; its name names its file.
    """

    def measured(measure: Callable[[BenchDocument], None]) -> dict:
        measure(own := BenchDocument(bench))
        return {"rows": own.rows, "omissions": own.omissions, "summary": own.summary}

    document = BenchDocument(bench)
    for number, (name, measure) in enumerate(parts.items()):
        progress(number / len(parts), name)
        found = kept(work / f"{name}.json" if work else None, partial(measured, measure), key)
        document.rows += found["rows"]
        document.omissions += found["omissions"]
        document.summary |= found["summary"]
    return document


def means(rows: Sequence[Mapping[str, float]], scores: Iterable[str]) -> dict[str, float]:
    """Return the mean of each score over the rows that have it as a finite number, without scores that none has."""
    found = {score: [row[score] for row in rows if score in row and np.isfinite(row[score])] for score in scores}
    return {score: float(np.mean(values)) for score, values in found.items() if values}


def named(prefix: str, scores: Mapping[str, float], suffix: str = "") -> dict[str, float]:
    """Return `scores` under the names that a summary has for them: `PREFIX.SCORESUFFIX`."""
    return {f"{prefix}.{score}{suffix}": value for score, value in scores.items()}
