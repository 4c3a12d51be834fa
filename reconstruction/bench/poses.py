"""Measures where each method finds the cameras: error against run time, rig error, number of views and length.

Every method is given the same spikes and the same rig as drawn, which is the true one misplaced by about so many
degrees, cm and percent of the focal length. Errors are after similarity alignment. Depth errors are those of a plane
sweep with the cameras found, on still pixels, and of the method's own points where it has any.
"""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from acquisition.bench_document import BenchDocument
from acquisition.progress import Progress, silent
from acquisition.recording.reader import Recording
from acquisition.revision import code_revision
from acquisition.scenes.boards import charuco
from acquisition.scenes.misplaced import misplaced
from reconstruction.bench.conventions import HOLDOUT, VIEWS, KnownRecording, means, measure_parts, named
from reconstruction.bench.paper.digest import code_and_machine
from reconstruction.bench.paper.method import Method
from reconstruction.calibration.board_spec import parse_board
from reconstruction.calibration.boards import calibrate_board
from reconstruction.calibration.natural import gather, solve
from reconstruction.errors import ReconstructionError
from reconstruction.images.catalogue import method
from reconstruction.initialization.geometry import Geometry
from reconstruction.initialization.initialisers import INITIALISERS, InitOptions, msdi_alone
from reconstruction.initialization.pyramid import swept_maps
from reconstruction.initialization.sfm import sfm
from reconstruction.initialization.sweep import SweepOptions, depth_range_m
from reconstruction.metrics.poses import pose_errors
from rigs.rig import Rig, object_distance_m
from rigs.similarity import align

DATE = "2026-01-01"  # date written into the rigs found, which nobody keeps
BOARD = "board"  # the method that sees another recording
BOARD_SCENE, BOARD_TICKS = "board_charuco_moving", 2000
ERROR = 2.0  # usual error of the nominal rig, in degrees, cm and percent of the focal length
ERRORS = (0.0, 1.0, 3.0, 5.0)
ORDER = (HOLDOUT, *VIEWS)
COUNTS = (3, 5, 7)  # numbers of views
PLANES = (20, 40, 100)
TRIALS, TRIAL_TURNS_DEG = 20, (2.0, 4.0)
SWEPT = ("natural", "msdi", "msdi+ba")  # methods that are measured over nominal errors and numbers of views
SWEPT_CLIPS = 2  # recordings, the first ones, for these
SCORES = ("rotation_deg", "translation_percent", "focal_percent", "seconds", "abs_rel", "complete", "points_abs_rel")
CLOSE = 0.01  # relative error up to which a depth counts as complete
MOST_POINTS = 20000  # points of a method's own that are scored
LEARNED = Method("poses", {"init": "msdi"})  # what runs all that methods here do, networks included
WRONG = 0.5  # relative error at most, of a point behind a camera, say
Rows = Callable[[], list[dict]]
Run = Callable[[Recording, Sequence[str], int | None], Geometry]  # of a recording, views, and most planes (None: all)


def _colmap(name: str) -> Run:
    """Return COLMAP from scratch on the images of the middle of the clip by the method `name`."""
    return lambda recording, views, _: sfm(
        recording.rig, {view: method(name)(recording.stream(view), recording.planes // 2).intensity for view in views}
    )


def _by(name: str) -> Run:
    """Return one of the initialisers that a run may choose."""
    return lambda recording, views, planes: INITIALISERS[name](recording, views, InitOptions(planes=planes), silent)


def _board(recording: Recording, views: Sequence[str], planes: int | None) -> Geometry:
    found = calibrate_board(recording, parse_board(charuco().spec), DATE)
    return Geometry(found.rig, report=found.report)


METHODS: dict[str, Run] = {
    "nominal": _by("sweep"),
    "tfi+colmap": _colmap("tfi"),
    "msdi-image+colmap": _colmap("msdi"),
    "long+colmap": _by("sfm"),
    "natural": _by("natural"),
    "msdi": lambda recording, views, _: msdi_alone(recording, views),
    "msdi+ba": _by("msdi"),
    BOARD: _board,
}


@dataclass(frozen=True)
class Sight:
    """The circumstances of a measurement: error of the nominal rig, number of views, and planes (None: all)."""

    error: float = ERROR
    views: int = len(ORDER)
    planes: int | None = None


def bench_poses(
    clips: Sequence[KnownRecording],
    board: KnownRecording | None,
    work: Path,
    progress: Progress,
    *,
    quick: bool = False,
) -> BenchDocument:
    """Measure every method on every clip, then the best of them with worse rigs, fewer views and shorter recordings.

    `board` is a recording of the board that the method of that name sees. Rows of this code in the folder `work`
    are not measured again, so that a stopped bench resumes.
    """
    asked = [(clip, *part) for number, clip in enumerate(clips) for part in parts_of(number, clip, quick)]
    if board:
        asked.append((board, BOARD, lambda: [measured(BOARD, board)]))
    parts = {f"{clip.scene}-{clip.seed}-{about.replace(' ', '-')}": partial(_add, rows) for clip, about, rows in asked}
    document = measure_parts("poses", parts, work, progress, code_and_machine(LEARNED))
    _summarise(document)
    document.omissions += [
        "TFI + DUSt3R: no checkpoint is at hand (its licence forbids to ship one); `--init dust3r` takes one's own",
        f"one seed a scene; nominal errors and views on the first {SWEPT_CLIPS} scenes only",
    ]
    progress(1.0, f"{len(document.rows)} rows")
    return document


def parts_of(number: int, clip: KnownRecording, quick: bool) -> Iterator[tuple[str, Rows]]:
    """Yield the names and the work of the measurements on a clip, which is the one of that number."""

    def part(name: str, sight: Sight = Sight(), *, scored: bool = False) -> Rows:
        return lambda: [measured(name, clip, sight, scored=scored)]

    for name in METHODS:
        if name != BOARD:
            yield name, part(name, scored=True)
    if quick:
        return
    for name in SWEPT if number < SWEPT_CLIPS else ():
        yield from ((f"{name} at {error:g}", part(name, Sight(error=error))) for error in ERRORS)
        yield from ((f"{name} of {views}", part(name, Sight(views=views))) for views in COUNTS)
    yield from ((f"natural in {planes}", part("natural", Sight(planes=planes))) for planes in PLANES)
    yield "natural from random rigs", lambda: _trials(clip)


def _add(rows: Rows, document: BenchDocument) -> None:
    document.rows += [row | {"revision": code_revision()} for row in rows()]


def measured(method: str, clip: KnownRecording, sight: Sight = Sight(), *, scored: bool = False) -> dict:
    """Return the row of a method: its errors, or why it refused; `scored` adds those of depths and points."""
    nominal = misplaced(clip.rig, sight.error, clip.seed)
    ids = [c for c in nominal.ids if c in ORDER[: sight.views]]
    about = {"method": method, "scene": clip.scene, "seed": clip.seed}
    about |= {"nominal": sight.error, "views": sight.views} | ({"planes": sight.planes} if sight.planes else {})
    began = time.perf_counter()
    try:
        found = METHODS[method](replace(clip.recording, rig=nominal), ids, sight.planes)
    except ReconstructionError as refusal:
        return about | {"seconds": time.perf_counter() - began, "refused": str(refusal)}
    row = about | {"seconds": time.perf_counter() - began} | _errors(found.rig.only(ids), clip.rig)
    if method == BOARD:
        row |= {"scale_percent": 100 * abs(align(found.rig, clip.rig).scale - 1)}
    row |= {name: found.report[name] for name in ("rotation_sd_deg", "focal_sd_percent") if name in found.report}
    if scored:
        row |= _sweep(found.rig.only(ids), clip) | _own_points(found, clip)
    return row


def _errors(found: Rig, true: Rig) -> dict[str, float]:
    off = pose_errors(found, true, object_distance_m(true.cameras))
    return {name: getattr(off, name) for name in ("rotation_deg", "translation_percent", "focal_percent")}


def _sweep(found: Rig, clip: KnownRecording) -> dict[str, float]:
    """Return `abs_rel` of the confirmed depths of a plane sweep on long-window images, and `complete`.

    `complete` is the share of the still pixels whose depth is within CLOSE of the truth.
    """
    cameras = list(align(found, clip.rig).carry_rig(found).cameras)
    images = [clip.long_images[c.id] for c in cameras]
    maps = swept_maps(cameras, images, SweepOptions(*depth_range_m(clip.rig.cameras)))
    off, pixels = [], 0
    for camera, swept in zip(cameras, maps, strict=True):
        depth, still = _truth(clip, camera.id)
        seen = still & np.isfinite(swept.depth)
        off.append(np.abs(swept.depth - depth)[seen] / depth[seen])
        pixels += int(still.sum())
    errors = np.concatenate(off)
    if not len(errors):
        return {"complete": 0.0}
    return {"abs_rel": float(errors.mean()), "complete": float((errors < CLOSE).sum() / pixels)}


def _own_points(found: Geometry, clip: KnownRecording) -> dict[str, float]:
    """Return `points`, a method's number of points, and `points_abs_rel`: each in its best view, on still pixels."""
    if not len(found.points):
        return {}
    rng = np.random.default_rng(0)
    chosen = rng.permutation(len(found.points))[:MOST_POINTS]
    points = align(found.rig, clip.rig).apply(found.points[chosen])
    best = np.full(len(points), np.inf)
    for camera in clip.rig.cameras:
        depth, still = _truth(clip, camera.id)
        pixels, seen = camera.project(points)
        where = np.flatnonzero(seen)
        column, row = pixels[where].astype(np.int64).T
        z, true = camera.cam_from_rig.apply(points[where])[:, 2], depth[row, column]
        error = np.where(still[row, column], np.abs(z - true) / true, np.inf)
        best[where] = np.minimum(best[where], error)
    known = np.isfinite(best)
    if not known.any():
        return {"points": float(len(found.points))}
    return {"points": float(len(found.points)), "points_abs_rel": float(np.minimum(best[known], WRONG).mean())}


def _truth(clip: KnownRecording, camera_id: str) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Return the true depth [H, W] in m at the middle of the clip, and where it is known and nothing moves."""
    planes = clip.truth.planes(camera_id)
    frame = clip.truth.frame(camera_id, planes[len(planes) // 2])
    return frame.depth, ~frame.moving & np.isfinite(frame.depth)


def _trials(clip: KnownRecording) -> list[dict]:
    """Calibrate from TRIALS random rigs; features and matches do not depend on the rig and are made once."""
    evidence, rng, rows = gather(clip.long_images), np.random.default_rng(clip.seed), []
    for trial in range(TRIALS):
        turn = float(rng.uniform(*TRIAL_TURNS_DEG))
        nominal = misplaced(clip.rig, ERROR, 1000 * clip.seed + trial, turn_deg=turn)
        row = {"method": "natural.trial", "scene": clip.scene, "seed": clip.seed, "trial": trial, "turn_deg": turn}
        try:
            found = solve(nominal, evidence, DATE)
            row |= _errors(found.rig, clip.rig) | {"rotation_sd_deg": found.report["rotation_sd_deg"]}
        except ReconstructionError as refusal:
            row |= {"refused": str(refusal)}
        rows.append(row)
    return rows


def _summarise(document: BenchDocument) -> None:
    """Add means over the scenes: of each method as it is, by nominal error, views and planes; and the trials' worst.

    `natural.trial.least_expected` and `most_expected`: the deviation that a calibration states, over its true error.
    """
    for name in METHODS:
        rows = [r for r in document.rows if r["method"] == name]
        for key, wanted in (("nominal", ERRORS), ("views", COUNTS), ("planes", PLANES)):
            for value in wanted:
                _add_means(document, f"{name}.{key}{value:g}", [r for r in rows if r.get(key) == value], SCORES[:4])
        plain = [r for r in rows if r["nominal"] == ERROR and r["views"] == len(ORDER) and "planes" not in r]
        _add_means(document, name, plain, SCORES)
    trials = [r for r in document.rows if r["method"] == "natural.trial"]
    if trials:
        _add_means(document, "natural.trial", trials, SCORES[:3])
        document.summary["natural.trial.count"] = len(trials)
        for score in SCORES[:2]:
            worst = max((r[score] for r in trials if score in r), default=float("nan"))
            document.summary[f"natural.trial.worst_{score}"] = worst
        stated = [r["rotation_sd_deg"] / r["rotation_deg"] for r in trials if r.get("rotation_deg")]
        if stated:
            document.summary |= named("natural.trial", {"least_expected": min(stated), "most_expected": max(stated)})


def _add_means(document: BenchDocument, name: str, rows: Sequence[dict], scores: Sequence[str]) -> None:
    """Add the means over the rows that were not refused, and how many were."""
    found = [row for row in rows if "refused" not in row]
    document.summary |= named(name, means(found, scores))
    refused = len(rows) - len(found)
    if refused:
        document.summary[f"{name}.refused"] = refused
        document.omissions.append(f"{name}: refused on {refused} of {len(rows)} recordings, which its means leave out")
