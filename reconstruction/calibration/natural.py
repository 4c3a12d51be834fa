"""Cameras from an ordinary recording and the rig as drawn: features, gates, annealed adjustment, patches, a verdict.

Metric scale, place and turn of the whole come from the nominal cameras alone. From them, a redescending loss falls into
wrong minima at once, and so does a free focal length: points are triangulated, then held less and less. Letters: T
tracks, V views.
"""

import itertools
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from acquisition.progress import Progress, silent
from reconstruction.calibration.adjustment import Solution, adjust, covariance
from reconstruction.calibration.calibrated import Calibrated, Fit, calibrated, camera_sds
from reconstruction.calibration.edge_points import with_edges
from reconstruction.calibration.edges import find_edges
from reconstruction.calibration.features import Features, Image, find_features
from reconstruction.calibration.matches import Gate, Matches, Pair, Tracks, gated, joined, matched, verified
from reconstruction.calibration.moments import Movers
from reconstruction.calibration.natural_lens import (
    DISTORTION_SD,
    lens_groups,
    lens_report,
    rebends,
    with_lens,
    with_lens_of,
)
from reconstruction.calibration.patches import refined
from reconstruction.calibration.problem import Freedom, Loss, Observations, Problem, ScenePoints, State
from reconstruction.calibration.projection import Cameras
from reconstruction.calibration.verdict import Evidence, judge, refuse_blind, refuse_few, refuse_unsure
from rigs.camera import Camera
from rigs.rig import Rig, object_distance_m
from rigs.similarity import align
from rigs.transform import Floats

NOMINAL_GATE = Gate(45.0)
AFTER_MSDI = Gate(15.0, along=1.0)  # its cameras are off by a few tenths of a degree at most
COARSE_GATE = Gate(8.0, along=1.0)  # once turns are found
LEAST_VIEWS = 3  # fewest views of a track
MOST_TRACKS = 1000
MOST_LENSES = 2  # times that matches are judged anew by a lens that was found
COARSE_TRACKS = 400
CELLS = (8, 5)  # across and down a view, that tracks are spread over
BEND_PX = 0.3  # Cauchy's, at the end
FEATURE_SD_PX, PATCH_SD_PX = 0.3, 0.1
HELD_M = 1e-4
ROUGHLY = 1e-3  # gain at which a step on the way is good enough
FOCAL_SD = 0.02  # prior deviation of a nominal focal length, as a share
CENTER_SD_M = 0.02  # prior deviation of a nominal camera centre
SURE_DEG = 0.01  # mean deviation of the turns by features alone, below which edges are not looked at
STEPS = ((10.0, 1e-3), (5.0, 4e-3), (3.0, CENTER_SD_M), (1.0, CENTER_SD_M))  # Cauchy's bend in px, centre prior in m


def calibrate_natural(
    rig: Rig,
    images: Mapping[str, Image],
    date: str,
    progress: Progress = silent,
    *,
    gate: Gate = NOMINAL_GATE,
    seed: int = 0,
    movers: Movers | None = None,
) -> Calibrated:
    """Find the poses of the cameras of `rig` that have an image, and one focal factor; the others keep what they have.

    `images` (camera id to [H, W], spikes per tick) are of the same instant or the same long window; `date` is the
    calibration's, in ISO form; `gate` is what the rig as drawn says of matches, `seed` that of all draws; `movers` are
    looked at where still things give fewer than MOST_TRACKS. Raises GeometryError, with the reason, where the result
    could not be trusted: keep the nominal rig then.
    """
    began = time.monotonic()
    ordered = {c: images[c] for c in rig.ids if c in images}
    refuse_blind(ordered)
    found = solve(rig, gather(ordered, progress), date, progress, gate=gate, seed=seed, movers=movers)
    found.report["seconds"] = round(time.monotonic() - began, 3)
    return found


def gather(
    images: Mapping[str, Image], progress: Progress = silent, *, where: Mapping[str, NDArray[np.bool_]] | None = None
) -> Evidence:
    """Find the features of all images, or those in the masks `where`, and match every two; nothing here knows a rig."""
    features = []
    for i, (camera, picture) in enumerate(images.items()):
        features.append(find_features(picture, where[camera] if where else None))
        progress(0.3 * (i + 1) / len(images), f"features of {camera}: {len(features[-1])}")
    candidates = {(a, b): matched(features[a], features[b]) for a, b in itertools.combinations(range(len(images)), 2)}
    progress(0.5, f"{sum(map(len, candidates.values()))} matches")
    return Evidence(images, features, candidates, where)


def solve(
    rig: Rig,
    evidence: Evidence,
    date: str,
    progress: Progress = silent,
    *,
    gate: Gate = NOMINAL_GATE,
    seed: int = 0,
    movers: Movers | None = None,
) -> Calibrated:
    """Return what `calibrate_natural` does, from features and matches that were gathered before."""
    nominal = rig.only(evidence.images)
    seen, solution, parts = _annealed(nominal, evidence, movers, gate, seed)
    for _ in range(MOST_LENSES):
        if not rebends(solution):
            break
        lens = lens_groups(solution)
        bent = with_lens_of(nominal, solution)  # the lens lets matches through that gates refused without it
        seen, solution, parts = _annealed(bent, evidence, movers, gate, seed, lens)
    progress(0.6, f"{sum(map(len, parts))} tracks")
    tracks = Tracks.of([refined(part, list(one.images.values())) for part, one in zip(parts, seen, strict=True)])
    progress(0.8, "patches refined")
    fine = observed(tracks, PATCH_SD_PX)
    solution = with_focal(solution.state, fine, Loss("cauchy", BEND_PX / PATCH_SD_PX), lens_groups(solution))
    solution, edge_points = _with_edges(with_lens(solution), nominal, seen, gate)
    progress(0.95, "adjusted")
    judge(nominal, solution)
    found = _calibrated(rig, nominal, solution, ([len(part) for part in parts], edge_points), date)
    progress(1.0, str(found.report["summary"]))
    return found


def _annealed(
    nominal: Rig, still: Evidence, movers: Movers | None, gate: Gate, seed: int, lens: Sequence[str] = ()
) -> tuple[list[Evidence], Solution, list[Tracks]]:
    """Return the evidence, the cameras by its features, with their lens where it shows, and its tracks."""
    seen, tracks = _looked_at(nominal, still, movers, gate, seed)
    start, parts = _coarse(nominal, seen, tracks, seed)
    return seen, with_lens(annealed(start, Tracks.of(parts), lens)), parts


def _looked_at(
    nominal: Rig, still: Evidence, movers: Movers | None, gate: Gate, seed: int
) -> tuple[list[Evidence], Tracks]:
    """Return the evidence, with that of movers where still things are too few, and the tracks that the rig allows."""
    seen, tracks = [still], [_verified(nominal, still, gate, seed)]
    if movers is not None and len(tracks[0]) < MOST_TRACKS:
        seen += [gather(moment.images, where=moment.moving) for moment in movers()]
        tracks += [_verified(nominal, one, gate, seed) for one in seen[1:]]
    return seen, Tracks.of(tracks)


def _verified(nominal: Rig, evidence: Evidence, gate: Gate, seed: int) -> Tracks:
    """Return the tracks of matches that the nominal rig allows and one fundamental matrix a pair explains."""
    features = evidence.features
    allowed = _allowed(nominal.cameras, features, evidence.candidates, gate)
    for (a, b), pairs in allowed.items():
        one, other = features[a].places[pairs[:, 0]], features[b].places[pairs[:, 1]]
        places = nominal.cameras[a].straightened(one), nominal.cameras[b].straightened(other)
        allowed[a, b] = pairs[verified(places, seed)]
    return joined(features, allowed, LEAST_VIEWS)


def _coarse(nominal: Rig, seen: Sequence[Evidence], tracks: Tracks, seed: int) -> tuple[Solution, list[Tracks]]:
    """Find the cameras' turns from the verified tracks, and of each evidence the tracks that these turns allow."""
    refuse_few(nominal.ids, tracks)
    start = coarse(Cameras.of(nominal.cameras), spread(tracks, nominal.cameras, COARSE_TRACKS, seed))
    turned = start.state.cameras.written_to(nominal).cameras
    parts = [
        joined(one.features, _allowed(turned, one.features, one.candidates, COARSE_GATE), LEAST_VIEWS) for one in seen
    ]
    total = len(refuse_few(nominal.ids, Tracks.of(parts)))
    share = min(1.0, MOST_TRACKS / total)
    return start, [spread(part, nominal.cameras, round(share * len(part)), seed) for part in parts]


def _allowed(
    cameras: Sequence[Camera], features: Sequence[Features], candidates: Mapping[Pair, Matches], gate: Gate
) -> dict[Pair, Matches]:
    """Return the candidates that the cameras allow."""
    distance_m = object_distance_m(cameras)
    found = {}
    for (a, b), pairs in candidates.items():
        places = features[a].places[pairs[:, 0]], features[b].places[pairs[:, 1]]
        found[a, b] = pairs[gated(places, (cameras[a], cameras[b]), gate, distance_m)]
    return found


def spread(tracks: Tracks, cameras: Sequence[Camera], most: int, seed: int) -> Tracks:
    """Choose at most `most` tracks, spread over the picture, those that more views see first."""
    if len(tracks) <= most:
        return tracks
    sizes = np.array([(c.width, c.height) for c in cameras])
    at = np.nanmean(tracks.places / sizes, axis=1)
    cell = (np.clip(at, 0, 0.999) * CELLS).astype(np.int64) @ (1, CELLS[0])
    dice = np.random.default_rng(seed).random(len(tracks))
    order = np.lexsort((dice, -tracks.seen.sum(axis=1), cell))
    _, first = np.unique(cell[order], return_index=True)
    rank = np.arange(len(order)) - np.repeat(first, np.diff([*first, len(order)]))
    return tracks.only(np.sort(order[np.argsort(rank, kind="stable")[:most]]))


def _with_edges(solution: Solution, nominal: Rig, seen: Sequence[Evidence], gate: Gate) -> tuple[Solution, int]:
    """Return the solution by edges of still things too, where features alone leave it unsure, and how many points."""
    cameras = solution.state.cameras
    sds = camera_sds(covariance(solution.problem, solution.state), solution.problem.freedom, cameras, metric=False)
    if np.mean([sd.rotation_deg for sd in sds]) < SURE_DEG:
        return solution, 0
    moving = seen[1].where if len(seen) > 1 else None
    edges = [find_edges(image, moving[view] if moving else None) for view, image in seen[0].images.items()]
    return with_edges(solution, edges, gate, object_distance_m(nominal.cameras))


def _calibrated(rig: Rig, nominal: Rig, solution: Solution, counts: tuple[Sequence[int], int], date: str) -> Calibrated:
    """Return the outcome for `rig`, of which the cameras of `nominal` were adjusted.

    `counts` are those of the tracks by evidence, and of the points on edges.
    """
    tracks, moving, edges = sum(counts[0]), sum(counts[0][1:]), counts[1]
    counted = f"{tracks} tracks" + (f", {moving} of them on movers" if moving else "")
    counted += f", {edges} points on edges" if edges else ""
    cameras, problem, fit = solution.state.cameras, solution.problem, Fit.of(solution)
    sds = camera_sds(covariance(problem, solution.state), problem.freedom, cameras, metric=False)
    sd_deg = refuse_unsure(sds)
    found = cameras.written_to(nominal)
    focal = solution.moved("focal")
    report: dict[str, object] = {
        "date": date,
        "method": "natural",
        "summary": f"{counted}, residual {fit.rms_px:.3f} px, rotations to {sd_deg:.4f} degrees, focal {focal:+.2%}",
        "tracks": tracks,
        "moving_tracks": moving,
        "edge_points": edges,
        "focal_change": focal,
        "focal_sd_percent": sds[0].focal_percent,
        "metric_scale": "from the nominal camera centres alone",
    } | lens_report(solution, found, nominal)
    return calibrated(rig, align(found, nominal).carry_rig(found), solution, fit, sds, report)


def coarse(cameras: Cameras, tracks: Tracks) -> Solution:
    """Find the turns, with centres and focal length all but held: enough to judge matches by."""
    freedom = Freedom.poses(len(cameras), HELD_M)
    state = State(cameras, ScenePoints(triangulated(cameras, tracks)), np.zeros(len(freedom.prior_sd)))
    problem = Problem(observed(tracks, FEATURE_SD_PX), freedom, Loss("huber", 3.0 / FEATURE_SD_PX))
    return Solution(problem, adjust(problem, state, least_gain=ROUGHLY))


def annealed(start: Solution, tracks: Tracks, lens: Sequence[str] = ()) -> Solution:
    """Adjust from a coarse solution to free poses, then to a free focal length and the parts of the `lens`."""
    cameras = start.state.cameras
    observations = observed(tracks, FEATURE_SD_PX)
    state = State(cameras, ScenePoints(triangulated(cameras, tracks)), start.state.steps)
    for px, center_m in STEPS:
        freedom = Freedom.poses(len(cameras), center_m)
        state = adjust(Problem(observations, freedom, Loss("cauchy", px / FEATURE_SD_PX)), state, least_gain=ROUGHLY)
    return with_focal(state, observations, Loss("cauchy", STEPS[-1][0] / FEATURE_SD_PX), lens)


def with_focal(state: State, observations: Observations, loss: Loss, lens: Sequence[str] = ()) -> Solution:
    """Adjust on with the focal length and the parts of the `lens` free, and other observations of the same points."""
    freedom = Freedom.poses(len(state.cameras), CENTER_SD_M).shared_focal(state.cameras, FOCAL_SD)
    for name in lens:
        freedom = freedom.shared(name, DISTORTION_SD)
    steps = np.append(state.steps, np.zeros(len(freedom.prior_sd) - len(state.steps)))
    problem = Problem(observations, freedom, loss)
    return Solution(problem, adjust(problem, replace(state, steps=steps), 40))


def observed(tracks: Tracks, sd_px: float) -> Observations:
    """Return every place of every track as an observation."""
    track, view = np.nonzero(tracks.seen)
    return Observations(view, track, tracks.places[track, view], np.full(len(track), sd_px))


def triangulated(cameras: Cameras, tracks: Tracks) -> Floats:
    """Return the points [T, 3] in m nearest to all rays of their tracks."""
    track, view = np.nonzero(tracks.seen)
    rays = np.insert(cameras.slopes(tracks.places[track, view], view), 2, 1.0, axis=1)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    rays = (rays[:, None] @ cameras.rotations[view])[:, 0]
    across = np.eye(3) - rays[:, :, None] * rays[:, None]
    normal, right = np.zeros((len(tracks), 3, 3)), np.zeros((len(tracks), 3))
    np.add.at(normal, track, across)
    np.add.at(right, track, (across @ cameras.centers[view][:, :, None])[:, :, 0])
    return np.asarray(np.linalg.solve(normal + 1e-9 * np.eye(3), right[:, :, None])[:, :, 0], dtype=np.float64)
