"""Cameras from an ordinary recording and the rig as drawn: features, gates, annealed adjustment, patches, a verdict.

Metric scale, place and turn of the whole come from the nominal cameras alone. Letters: V views.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from acquisition.progress import Progress, silent
from reconstruction.calibration.adjustment import covariance
from reconstruction.calibration.calibrated import Calibrated
from reconstruction.calibration.features import Features, Image, find_features
from reconstruction.calibration.matches import Gate, Matches, Pair, Tracks, all_pairs, gated, joined, matched, verified
from reconstruction.calibration.patches import refined
from reconstruction.calibration.problem import Loss
from reconstruction.calibration.projection import Cameras
from reconstruction.calibration.tracks_to_poses import (
    PATCH_SD_PX,
    Solution,
    annealed,
    coarse,
    observed,
    with_focal,
)
from reconstruction.calibration.uncertainty import camera_sds
from reconstruction.calibration.verdict import INLIER_PX, Evidence, judge, refuse_blind, refuse_unsure
from rigs.camera import Camera
from rigs.rig import Calibration, Rig, object_distance_m
from rigs.similarity import align

NOMINAL_GATE = Gate(45.0)
COARSE_GATE = Gate(8.0, along=1.0)  # once turns are found
LEAST_VIEWS = 3  # of a track
MOST_TRACKS = 1000
COARSE_TRACKS = 400
CELLS = (8, 5)  # across and down a view, that tracks are spread over
BEND_PX = 0.3  # Cauchy's, at the end


@dataclass(frozen=True)
class NaturalOptions:
    """`gate`: what the nominal rig allows; `patches`: whether places are refined to sub-pixel; `seed` of all draws."""

    gate: Gate = NOMINAL_GATE
    patches: bool = True
    seed: int = 0


AFTER_MSDI = NaturalOptions(Gate(15.0, along=1.0))  # its cameras are off by a few tenths of a degree at most


def calibrate_natural(
    rig: Rig,
    images: Mapping[str, Image],
    date: str,
    options: NaturalOptions | None = None,
    progress: Progress = silent,
) -> Calibrated:
    """The cameras of `rig` that have an image, poses and one focal factor found; the others keep what they have.

    `images` (camera id to [H, W], spikes per tick) are of the same instant or the same long window; `date` is the
    calibration's, in ISO form. Raises GeometryError, with the reason, where the result could not be trusted: keep the
    nominal rig then.
    """
    began = time.monotonic()
    ordered = {c: images[c] for c in rig.ids if c in images}
    refuse_blind(ordered)
    evidence = gather(ordered, progress)
    return solve(rig, evidence, date, options or NaturalOptions(), progress, began=began)


def gather(images: Mapping[str, Image], progress: Progress = silent) -> Evidence:
    """Features of all images and what matches between every two of them; knows nothing of a rig."""
    features = []
    for i, (camera, picture) in enumerate(images.items()):
        features.append(find_features(picture))
        progress(0.3 * (i + 1) / len(images), f"features of {camera}: {len(features[-1])}")
    candidates = {(a, b): matched(features[a], features[b]) for a, b in all_pairs(len(images))}
    progress(0.5, f"{sum(map(len, candidates.values()))} matches")
    return Evidence(images, features, candidates)


def solve(
    rig: Rig,
    evidence: Evidence,
    date: str,
    options: NaturalOptions,
    progress: Progress = silent,
    *,
    began: float | None = None,
) -> Calibrated:
    """`calibrate_natural` from what was gathered; `began` is when, on the monotonic clock, for the report."""
    began = time.monotonic() if began is None else began
    nominal = rig.only(evidence.images)
    start, tracks = _coarse(nominal, evidence, options)
    progress(0.6, f"{len(tracks)} tracks")
    solution = annealed(start, tracks)
    if options.patches:
        tracks = refined(tracks, list(evidence.images.values()))
    progress(0.8, "patches refined")
    fine = observed(tracks, PATCH_SD_PX)
    solution = with_focal(solution.state, fine, Loss("cauchy", BEND_PX / PATCH_SD_PX))
    progress(0.95, "adjusted")
    judge(nominal, solution)
    found = _calibrated(rig, nominal, solution, len(tracks), date)
    found.report["seconds"] = round(time.monotonic() - began, 3)
    progress(1.0, str(found.report["summary"]))
    return found


def _coarse(nominal: Rig, evidence: Evidence, options: NaturalOptions) -> tuple[Solution, Tracks]:
    """Turns found from what the nominal rig allows, and the tracks that these turns allow."""
    features = evidence.features
    allowed = _allowed(nominal.cameras, features, evidence.candidates, options.gate)
    for (a, b), pairs in allowed.items():
        allowed[a, b] = pairs[
            verified((features[a].places[pairs[:, 0]], features[b].places[pairs[:, 1]]), options.seed)
        ]
    tracks = evidence.enough(joined(features, allowed, LEAST_VIEWS))
    start = coarse(Cameras.of(nominal.cameras), spread(tracks, nominal.cameras, COARSE_TRACKS, options.seed))
    turned = start.state.cameras.written_to(nominal.cameras)
    tracks = joined(features, _allowed(turned, features, evidence.candidates, COARSE_GATE), LEAST_VIEWS)
    return start, spread(evidence.enough(tracks), nominal.cameras, MOST_TRACKS, options.seed)


def _allowed(
    cameras: Sequence[Camera], features: Sequence[Features], candidates: Mapping[Pair, Matches], gate: Gate
) -> dict[Pair, Matches]:
    """The candidates that the cameras allow."""
    distance_m = object_distance_m(cameras)
    found = {}
    for (a, b), pairs in candidates.items():
        places = features[a].places[pairs[:, 0]], features[b].places[pairs[:, 1]]
        found[a, b] = pairs[gated(places, (cameras[a], cameras[b]), gate, distance_m)]
    return found


def spread(tracks: Tracks, cameras: Sequence[Camera], most: int, seed: int) -> Tracks:
    """At most `most` tracks, spread over the picture, those that more views see first."""
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


def _calibrated(rig: Rig, nominal: Rig, solution: Solution, tracks: int, date: str) -> Calibrated:
    cameras, problem = solution.state.cameras, solution.problem
    sds = camera_sds(covariance(problem, solution.state), problem.freedom, cameras, metric=False)
    refuse_unsure(sds)
    found = replace(nominal, cameras=cameras.written_to(nominal.cameras))
    found = align(found, nominal).carry_rig(found)
    residuals, obs = solution.residuals_px(), problem.observations
    good = np.linalg.norm(residuals, axis=1) < INLIER_PX
    rms = float(np.sqrt((residuals[good] ** 2).sum(axis=1).mean()))
    sd_deg = float(np.mean([sd.rotation_deg for sd in sds]))
    focal = float(solution.state.steps[-1])
    report: dict[str, object] = {
        "method": "natural",
        "summary": f"{tracks} tracks, residual {rms:.3f} px, rotations to {sd_deg:.4f} degrees, focal {focal:+.2%}",
        "tracks": tracks,
        "observations": len(obs),
        "kept_share": float(good.mean()),
        "residual_px": rms,
        "rotation_sd_deg": sd_deg,
        "focal_change": focal,
        "focal_sd_percent": sds[0].focal_percent,
        "metric_scale": "from the nominal camera centres alone",
    }
    new = {camera.id: camera for camera in found.cameras}
    whole = replace(
        rig,
        cameras=tuple(new.get(c.id, c) for c in rig.cameras),
        poses="calibrated",
        calibration=Calibration(date, rms, sd_deg),
    )
    rows = np.concatenate([obs.pixels, residuals], axis=1)
    by_camera = {c: rows[good & (obs.camera == i)] for i, c in enumerate(nominal.ids)}
    return Calibrated(whole, dict(zip(nominal.ids, sds, strict=True)), report, by_camera)
