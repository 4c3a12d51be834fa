"""Cameras from a recording of a calibration board: sightings, adjustment, a verdict and a report.

The metres are the board's own; the nominal cameras say only where the rig's frame lies.
"""

from dataclasses import asdict

import numpy as np

from acquisition.progress import Progress, part, silent
from acquisition.recording.reader import Recording
from reconstruction.calibration.board_adjustment import K1, K2, K3, OWN, PRINCIPAL, TANGENTIAL, BoardSolution, solve
from reconstruction.calibration.board_sightings import Sightings, sight_board
from reconstruction.calibration.board_spec import BoardSpec
from reconstruction.calibration.calibrated import (
    INLIER_PX,
    OPTIMISM,
    Calibrated,
    CameraSd,
    Fit,
    calibrated,
    camera_sds,
    displacement,
)
from reconstruction.calibration.projection import Cameras
from reconstruction.errors import BadRunError, GeometryError
from rigs.rig import Rig, object_distance_m
from rigs.similarity import Similarity, align

MOST_RESIDUAL_PX = 0.3
LEAST_KEPT = 0.9  # share of observations within INLIER_PX
MOST_RESCALED = 0.1  # largest change of the baselines, as a share of the nominal ones
MOST_TURN_DEG, MOST_SHIFT = 15.0, 0.15  # largest way from the nominal rig; the shift as a share of the object distance
MOST_SD = CameraSd(rotation_deg=0.2, center_m=0.005, focal_percent=0.5)  # the centre's: of the object distance
_SPREAD_M = 0.01  # least extent of the cameras that tells a scale


def calibrate_board(recording: Recording, board: BoardSpec, date: str, progress: Progress = silent) -> Calibrated:
    """Find the cameras of `recording`'s rig from `board`; `date` is the calibration's, in ISO form.

    Raises BadRunError where the board or the rig is another one, GeometryError, with the reason and the cameras by
    name, where the board is not seen or its views do not determine the cameras.
    """

    sightings = sight_board(recording, board, part(progress, 0, 0.9))
    progress(0.9, f"{len(sightings)} corners at {sightings.poses} poses of the board")
    found = from_sightings(recording.rig, board, sightings, date)
    progress(1.0, str(found.report["summary"]))
    return found


def from_sightings(rig: Rig, board: BoardSpec, sightings: Sightings, date: str) -> Calibrated:
    """Find the cameras of `rig` from what they saw of the board; see `calibrate_board`."""
    solution, sightings = solve(rig, board.points, sightings)
    fit = Fit.of(solution)
    if fit.good.mean() < LEAST_KEPT or fit.rms_px > MOST_RESIDUAL_PX:
        raise BadRunError(
            f"found {fit.good.mean():.0%} of the corners within {INLIER_PX:g} px, residual {fit.rms_px:.2f} px",
            f"{LEAST_KEPT:.0%} and {MOST_RESIDUAL_PX:g} px",
            "the board is bent, or its millimetres are others",
            where=f"board {board.text}",
        )
    free = solution.state.cameras.written_to(rig)
    similarity = align(free, rig)
    _refuse_displaced(rig, similarity.carry_rig(free))
    _refuse_rescaled(board, rig, similarity.scale)
    aligned = _rigid(similarity, free, rig).carry_rig(free)
    cameras = Cameras.of(free.cameras)
    freedom = solution.problem.freedom
    sds = camera_sds(solution.covariance, freedom, cameras, metric=True)
    _refuse_undetermined(rig, sds, sightings)
    sd_deg = float(np.mean([sd.rotation_deg for sd in sds]))
    report = _report(board, rig, sightings, solution, sds) | {
        "baselines_of_nominal": 1 / similarity.scale,
        "date": date,
    }
    report["summary"] = (
        f"{sightings.poses} poses of the board, {len(sightings)} corners, residual {fit.rms_px:.3f} px, rotations to "
        f"{sd_deg:.4f} degrees, focal to {max(sd.focal_percent for sd in sds):.3f} %"
    )
    return calibrated(rig, aligned, solution, fit, sds, report)


def _rigid(similarity: Similarity, free: Rig, rig: Rig) -> Similarity:
    """Return the motion that lays the mean of the cameras found on that of the nominal ones and keeps their metres."""
    centers, drawn = (np.mean([c.center for c in one.cameras], axis=0) for one in (free, rig))
    return Similarity(1.0, similarity.rotation, drawn - similarity.rotation @ centers)


def _report(
    board: BoardSpec, rig: Rig, sightings: Sightings, solution: BoardSolution, sds: list[CameraSd]
) -> dict[str, object]:
    """Return what was found, as plain values."""
    found, pairs = solution.found, set(zip(sightings.camera.tolist(), sightings.pose.tolist(), strict=True))
    k = ", ".join(name for name in (K1, K2, TANGENTIAL, K3) if name in found)
    return {
        "method": "board",
        "board": board.text,
        "instants": sightings.instants,
        "poses": sightings.poses,
        "distinct_poses": sightings.distinct(),
        "corners": {c: int((sightings.camera == i).sum()) for i, c in enumerate(rig.ids)},
        "poses_seen": {c: sum(camera == i for camera, _ in pairs) for i, c in enumerate(rig.ids)},
        "corner_sd_px": solution.sd_px,
        "focal": "found for each camera" if OWN in found else "one factor found for all cameras",
        "principal_point": "found for each camera" if PRINCIPAL in found else "nominal: the board shows no other",
        "distortion": f"{k} found for each camera" if k else "nominal: the board shows no other",
        "metric_scale": "from the board",
        "scale_sd_percent": 100 * _scale_sd(solution),
        "sd": {c: asdict(sd) for c, sd in zip(rig.ids, sds, strict=True)},
    }


def _scale_sd(solution: BoardSolution) -> float:
    """Return the relative standard deviation of the rig's size."""
    cameras, freedom = solution.state.cameras, solution.problem.freedom
    apart = cameras.centers - cameras.centers.mean(axis=0)
    variance = float((apart**2).sum())
    if variance <= 0:
        return 0.0
    steps = np.zeros((len(cameras), freedom.mixing.shape[1]))
    steps[:, 3:6] = apart / variance
    row = np.einsum("cp,cpg->g", steps, freedom.mixing)
    return float(np.sqrt(OPTIMISM * row @ solution.covariance @ row))


def _refuse_rescaled(board: BoardSpec, rig: Rig, scale: float) -> None:
    centers = np.array([camera.center for camera in rig.cameras])
    if np.ptp(centers, axis=0).max() > _SPREAD_M and abs(scale - 1) > MOST_RESCALED:
        raise BadRunError(
            f"found the cameras {1 / scale:.2f} times as far apart as the rig file has them",
            f"that within {MOST_RESCALED:.0%}",
            f"the board is printed at {scale:.2f} times its SPEC: measure it, or the rig file is another array's",
            where=f"board {board.text}",
        )


def _refuse_displaced(rig: Rig, found: Rig) -> None:
    distance_m = object_distance_m(rig.cameras)
    for camera, drawn in zip(found.cameras, rig.cameras, strict=True):
        off = displacement(camera, drawn)
        if off.turn_deg > MOST_TURN_DEG or off.shift_m > MOST_SHIFT * distance_m:
            raise GeometryError(
                f"found {camera.id} {off.turn_deg:.1f} degrees and {100 * off.shift_m:.1f} cm off the rig file",
                f"at most {MOST_TURN_DEG:g} and {100 * MOST_SHIFT * distance_m:.0f}",
                "cables are swapped, or the rig file is another array's",
            )


def _refuse_undetermined(rig: Rig, sds: list[CameraSd], sightings: Sightings) -> None:
    """Raise GeometryError naming the cameras that the views leave open."""
    most_m = MOST_SD.center_m * object_distance_m(rig.cameras)
    few = [
        f"{c} ({sd.rotation_deg:.2g} degrees, {1e3 * sd.center_m:.2g} mm, focal length {sd.focal_percent:.2g} %)"
        for c, sd in zip(rig.ids, sds, strict=True)
        if sd.rotation_deg > MOST_SD.rotation_deg or sd.center_m > most_m or sd.focal_percent > MOST_SD.focal_percent
    ]
    if few:
        raise GeometryError(
            f"found {sightings.poses} poses of the board, which leave {', '.join(few)} too uncertain",
            f"{MOST_SD.rotation_deg:g} degrees, {1000.0 * most_m:.2g} mm, {MOST_SD.focal_percent:g} % at most",
            "show the board near and far, at several tilts, in every camera",
        )
