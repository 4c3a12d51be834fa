"""Where the cameras stand, by every method: error against run time, over nominal errors, views, and recording lengths.

Every method is given the same spikes and the same rig as drawn, which is the true one misplaced by about so many
degrees, cm and percent of the focal length. Errors are after similarity alignment; depth is by a plane sweep with the
cameras found, on still pixels, and of the method's own points where it has any.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from acquisition.bench_document import BenchDocument
from acquisition.durable import write_json
from acquisition.progress import Progress
from acquisition.revision import code_revision
from acquisition.scenes.misplaced import misplaced
from reconstruction.bench.pose_clip import PoseClip
from reconstruction.bench.pose_methods import BOARD, DATE, METHODS, PoseMethod
from reconstruction.bench.pose_scores import score_own_points, score_sweep
from reconstruction.calibration.natural import NaturalOptions, gather, solve
from reconstruction.errors import ReconstructionError
from reconstruction.metrics.poses import pose_errors
from rigs.rig import Rig, object_distance_m
from rigs.similarity import align

ERROR = 2.0  # of the nominal rig where nothing else is said
ERRORS = (0.0, 1.0, 3.0, 5.0)
ORDER = ("cam11", "cam01", "cam10", "cam12", "cam21", "cam00", "cam02", "cam20", "cam22")
VIEWS = (3, 5, 7)
PLANES = (20, 40, 100)
TRIALS, TRIAL_TURNS_DEG = 20, (2.0, 4.0)
SWEPT = ("natural", "msdi", "msdi+ba")  # over nominal errors and views
SWEPT_CLIPS = 2  # the first so many
SCORES = ("rotation_deg", "translation_percent", "focal_percent", "seconds", "abs_rel", "complete", "points_abs_rel")


def bench_poses(
    clips: Sequence[PoseClip], board: PoseClip | None, work: Path, progress: Progress, *, quick: bool = False
) -> BenchDocument:
    """Every method on every clip; then what the best of them take of worse rigs, fewer views, shorter recordings.

    `board` is a recording of the board that the method of that name sees. What is in the folder `work` is not measured
    again, so that a stopped bench resumes.
    """
    document = BenchDocument("poses")
    jobs = [(clip, job) for number, clip in enumerate(clips) for job in jobs_of(number, quick)]
    if board:
        jobs.append((board, Job(BOARD.name, lambda clip: [measured(BOARD, clip)])))
    for number, (clip, job) in enumerate(jobs):
        progress(number / len(jobs), f"{clip.scene}: {job.about}")
        document.rows += job.kept(clip, work)
    _summarise(document)
    document.omissions += [
        "TFI + DUSt3R: no checkpoint is at hand (its licence forbids to ship one); `--init dust3r` takes one's own",
        f"one seed a scene; nominal errors and views on the first {SWEPT_CLIPS} scenes only",
    ]
    progress(1.0, f"{len(document.rows)} rows")
    return document


@dataclass(frozen=True)
class Job:
    """Some rows of one clip."""

    about: str
    run: Callable[[PoseClip], list[dict]]

    def kept(self, clip: PoseClip, work: Path) -> list[dict]:
        """The rows, measured now or found in `work`."""
        file = work / f"{clip.scene}-{clip.seed}-{self.about.replace(' ', '-')}.json"
        if not file.exists():
            file.parent.mkdir(parents=True, exist_ok=True)
            write_json(file, {"rows": [row | {"revision": code_revision()} for row in self.run(clip)]})
        return json.loads(file.read_text())["rows"]


def jobs_of(number: int, quick: bool) -> list[Job]:
    """What is measured on the clip of that number."""
    jobs = [Job(name, lambda clip, m=method: [measured(m, clip, scored=True)]) for name, method in METHODS.items()]
    if quick:
        return jobs
    for method in (METHODS[name] for name in SWEPT if number < SWEPT_CLIPS):
        jobs += [Job(f"{method.name} at {e:g}", lambda c, m=method, e=e: [measured(m, c, error=e)]) for e in ERRORS]
        jobs += [Job(f"{method.name} of {v}", lambda c, m=method, v=v: [measured(m, c, views=v)]) for v in VIEWS]
    natural = METHODS["natural"]
    jobs += [Job(f"natural in {n}", lambda c, n=n: [measured(natural, c, planes=n)]) for n in PLANES]
    return [*jobs, Job("natural from random rigs", _trials)]


def measured(
    method: PoseMethod,
    clip: PoseClip,
    *,
    error: float = ERROR,
    views: int = len(ORDER),
    planes: int | None = None,
    scored: bool = False,
) -> dict:
    """A row: the cameras found and how far they are off, or why there are none; `scored` with depths and points."""
    nominal = misplaced(clip.rig, error, clip.seed)
    ids = [c for c in nominal.ids if c in ORDER[:views]]
    about = {"method": method.name, "scene": clip.scene, "seed": clip.seed, "nominal": error, "views": views}
    about |= {"planes": planes} if planes else {}
    began = time.perf_counter()
    try:
        found = method.run(clip.recording, nominal, ids, planes)
    except ReconstructionError as refusal:
        return about | {"seconds": time.perf_counter() - began, "refused": str(refusal)}
    row = about | {"seconds": time.perf_counter() - began} | _errors(found.rig.only(ids), clip.rig)
    if method is BOARD:
        row |= {"scale_percent": 100 * abs(align(found.rig, clip.rig).scale - 1)}
    for name in ("rotation_sd_deg", "focal_sd_percent"):
        row |= {name: found.report[name]} if name in found.report else {}
    if scored:
        row |= score_sweep(found.rig.only(ids), clip) | score_own_points(found, clip)
    return row


def _errors(found: Rig, true: Rig) -> dict[str, float]:
    off = pose_errors(found, true, object_distance_m(true.cameras))
    return {name: getattr(off, name) for name in ("rotation_deg", "translation_percent", "focal_percent")}


def _trials(clip: PoseClip) -> list[dict]:
    """Natural calibration from TRIALS random rigs; features and matches, which know nothing of a rig, are made once."""
    evidence, rng, rows = gather(clip.long_images), np.random.default_rng(clip.seed), []
    for trial in range(TRIALS):
        turn = float(rng.uniform(*TRIAL_TURNS_DEG))
        nominal = misplaced(clip.rig, ERROR, 1000 * clip.seed + trial, turn_deg=turn)
        row = {"method": "natural.trial", "scene": clip.scene, "seed": clip.seed, "trial": trial, "turn_deg": turn}
        try:
            found = solve(nominal, evidence, DATE, NaturalOptions())
            row |= _errors(found.rig, clip.rig) | {"rotation_sd_deg": found.report["rotation_sd_deg"]}
        except ReconstructionError as refusal:
            row |= {"refused": str(refusal)}
        rows.append(row)
    return rows


def _summarise(document: BenchDocument) -> None:
    """Means over the scenes: of each method as it is; by nominal error, views and planes; and the trials' worst."""
    for name in (*METHODS, BOARD.name):
        rows = [r for r in document.rows if r["method"] == name]
        for key, wanted in (("nominal", ERRORS), ("views", VIEWS), ("planes", PLANES)):
            for value in wanted:
                _means(document, f"{name}.{key}{value:g}", [r for r in rows if r.get(key) == value], SCORES[:4])
        plain = [r for r in rows if r["nominal"] == ERROR and r["views"] == len(ORDER) and "planes" not in r]
        _means(document, name, plain, SCORES)
    trials = [r for r in document.rows if r["method"] == "natural.trial"]
    if trials:
        _means(document, "natural.trial", trials, SCORES[:3])
        document.summary["natural.trial.count"] = len(trials)
        for score in SCORES[:2]:
            worst = max((r[score] for r in trials if score in r), default=float("nan"))
            document.summary[f"natural.trial.worst_{score}"] = worst


def _means(document: BenchDocument, name: str, rows: Sequence[dict], scores: Sequence[str]) -> None:
    if not rows:
        return
    for score in scores:
        values = [r[score] for r in rows if score in r and (score != "seconds" or "refused" not in r)]
        if values:
            document.summary[f"{name}.{score}"] = float(np.mean(values))
    refused = sum("refused" in r for r in rows)
    if refused:
        document.summary[f"{name}.refused"] = refused
        document.omissions.append(f"{name}: refused on {refused} of {len(rows)} recordings, which its means leave out")
