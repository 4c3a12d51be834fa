"""MSDI as an initialiser: spikes of the views of a rig around one instant to cameras and points.

Order: a few hundredths of a degree where views share texture, from a rig off by two; bundle adjustment of finer
features ends what it begins. Cost: 2 s a view and core at 400x250. Not for rigs whose drawing is off by more
than its gate (45 px at a focal length of 350). Source: Spike4DGS (NeurIPS 2025), whose form is not public; ours is
described in `network`.
"""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from acquisition.progress import Progress, silent
from acquisition.spikes.stream import SpikeStream
from reconstruction.calibration.calibrated import displacement
from reconstruction.errors import BadRunError, GeometryError
from reconstruction.initialization.geometry import FEWEST_VIEWS, Geometry
from reconstruction.initialization.sweep import DepthMap, agreed, back_project
from reconstruction.networks.image_networks import MOST_GROUP
from reconstruction.networks.msdi.inference import Inferred, infer_views
from reconstruction.networks.msdi.network import trained_msdi
from reconstruction.networks.rates import REACH
from rigs.rig import Rig
from rigs.similarity import align

MOST_VIEWS = 9
FEWEST_SPIKES = 2.0  # a pixel of a view on average, over the planes that are looked at
MOST_TURN_DEG, MOST_FOCAL = 9.0, 0.05  # largest way from the nominal rig; further is a wrong minimum
FEWEST_FITS, FEWEST_SHARE = 40, 0.4  # correspondences of a view that agree with the cameras found
LEAST_CONFIDENCE = 1.75  # least confidence of a point; 1 says nothing
AGREEMENT = 0.03  # largest gap between views' inverse depths, as a share of the object's inverse distance
BORDER = 2  # px of the working size that are left out


def initialise(
    streams: Mapping[str, SpikeStream],
    rig: Rig,
    instant_s: float,
    progress: Progress = silent,
    weights: Path | None = None,
) -> Geometry:
    """Find cameras and points of the views in `streams` (camera id to stream) at `instant_s` on the rig clock.

    `rig` is the nominal one; its cameras without a stream keep their nominal pose and get the focal factor found. A
    dark view keeps its nominal pose, too, and has no points. Raises GeometryError where the poses found are not to be
    trusted, BadRunError for views that are not 3 to 9, not of the rig or of several sizes, and BadRecordingError for an
    instant outside a clip.
    """
    plane = rig.clock.plane(instant_s)
    _check(streams, rig)
    spikes = {name: _spikes(streams[name], plane) for name in rig.ids if name in streams}
    seeing = [name for name, count in spikes.items() if count >= FEWEST_SPIKES]
    report: dict[str, object] = {"method": "msdi", "plane": plane, "dark": [c for c in spikes if c not in seeing]}
    if len(seeing) < FEWEST_VIEWS:
        raise GeometryError(f"found {len(seeing)} views with light", f"{FEWEST_VIEWS}", where="msdi")
    nominal = rig.only(seeing)
    inferred = infer_views(trained_msdi(weights), [streams[name] for name in seeing], nominal, plane, progress)
    matches, fits = _counted(inferred)
    by_view = {name: int(n) for name, n in zip(seeing, fits.sum(axis=1), strict=True)}
    report |= {"matches": matches, "fitting": round(float(fits.sum() / max(1, matches)), 3), "by_view": by_view}
    found = inferred.views.to_rig(nominal, inferred.factor)
    similarity = align(found, nominal)
    moved = similarity.carry_rig(found)
    _refuse_unsure(matches, fits, moved, nominal)
    points, confidence = _points(inferred, moved, similarity.scale)
    return Geometry(_completed(rig, moved), points, confidence, report, plane)


def _check(streams: Mapping[str, SpikeStream], rig: Rig) -> None:
    unknown = sorted(set(streams) - set(rig.ids))
    if unknown:
        raise BadRunError(f"found streams of {', '.join(unknown)}", f"cameras of rig {rig.name}")
    if not FEWEST_VIEWS <= len(streams) <= MOST_VIEWS:
        raise BadRunError(f"found {len(streams)} views", f"{FEWEST_VIEWS} to {MOST_VIEWS} for msdi")
    sizes = {(s.layout.width, s.layout.height) for s in streams.values()}
    sizes |= {(c.width, c.height) for c in rig.only(streams).cameras}
    if len(sizes) > 1:
        raise BadRunError(f"found views of the sizes {sorted(sizes)}", "one size for rig and streams")


def _spikes(stream: SpikeStream, plane: int) -> float:
    """Return a pixel's mean number of spikes, as far around `plane` as a dim view is looked at."""
    return float(stream.counts(*stream.around(plane, REACH * MOST_GROUP)).mean())


def _counted(inferred: Inferred) -> tuple[int, NDArray[np.int64]]:
    """Return the number of correspondences, and of those between each two views [v, v] that agree with the cameras."""
    used = inferred.solved.matches.information.diagonal(dim1=-2, dim2=-1).sum(-1) > 0
    return int(used.sum()), inferred.solved.adjusted.fits.numpy().sum(axis=1)


def _refuse_unsure(matches: int, fits: NDArray[np.int64], moved: Rig, nominal: Rig) -> None:
    share = fits.sum() / max(1, matches)
    if share < FEWEST_SHARE:
        raise GeometryError(f"found {share:.0%} of the correspondences to agree", f"{FEWEST_SHARE:.0%}", where="msdi")
    counts = fits.sum(axis=1) + fits.sum(axis=0)
    for camera, before, count in zip(moved.cameras, nominal.cameras, counts, strict=True):
        where = f"msdi, {camera.id}"
        if count < FEWEST_FITS:
            raise GeometryError(f"found {count} correspondences that agree", f"{FEWEST_FITS}", where=where)
        turn_deg = displacement(camera, before).turn_deg
        if turn_deg > MOST_TURN_DEG:
            raise GeometryError(f"found a turn of {turn_deg:.1f} degrees from the nominal rig", where=where)
        if abs(camera.fx / before.fx - 1) > MOST_FOCAL:
            raise GeometryError(f"found the focal length {camera.fx:.1f} px", f"{before.fx:.1f} to 5 %", where=where)


def _points(inferred: Inferred, moved: Rig, scale: float) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
    """Return the confident pixels that other views confirm, as points [N, 3] in m in the rig frame, and confidences.

    `scale` is that of the similarity which brought the cameras to `moved`.
    """
    height, width = inferred.depth.shape[1:]
    maps, factor = [], inferred.factor
    for camera, pinhole, depth in zip(moved.cameras, inferred.pinholes, inferred.depth, strict=True):
        lens = {"fx": camera.fx, "fy": camera.fy, "cx": pinhole.cx, "cy": pinhole.cy}
        lens = {name: value / factor for name, value in lens.items()}
        small = replace(pinhole, cam_from_rig=camera.cam_from_rig, width=width, height=height, pixels=None, **lens)
        maps.append(DepthMap(small, np.asarray(scale * depth, np.float32), np.zeros_like(depth)))
    tolerance = AGREEMENT / (scale * inferred.views.distance)
    points, sure = [], []
    for number, (reference, confidence) in enumerate(zip(maps, inferred.confidence, strict=True)):
        kept = agreed(maps, number, tolerance)
        kept &= confidence >= LEAST_CONFIDENCE
        kept[:BORDER], kept[-BORDER:], kept[:, :BORDER], kept[:, -BORDER:] = False, False, False, False
        points.append(back_project(reference.camera, reference.depth)[kept])
        sure.append(confidence[kept])
    return np.concatenate(points), np.concatenate(sure)


def _completed(rig: Rig, moved: Rig) -> Rig:
    """Return `rig` with the cameras of `moved`, and the others with the focal factor that those have."""
    factor = moved.cameras[0].fx / rig.camera(moved.ids[0]).fx
    wider = (replace(camera, fx=camera.fx * factor, fy=camera.fy * factor) for camera in rig.cameras)
    return replace(rig, cameras=tuple(moved.camera(c.id) if c.id in moved.ids else c for c in wider))
