"""Scores a run on the camera nobody trained on: against truth, beside the floors, or against its own spike counts."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from acquisition.progress import Progress, silent
from acquisition.recording.reader import Recording
from reconstruction.errors import BadRunError
from reconstruction.evaluation.floors import depth_blend, nearest_view
from reconstruction.evaluation.resection import Counted, resected
from reconstruction.images.composite import CompositeSource
from reconstruction.images.pixels import read_pixels
from reconstruction.images.response import Response
from reconstruction.initialization.gains import DARKEST
from reconstruction.initialization.sweep import depth_range_m, neighbours
from reconstruction.lenses.straight import straightening, view_of
from reconstruction.metrics.depth import abs_rel, delta_1_25
from reconstruction.metrics.image import mean_over, psnr_db, ssim_map
from reconstruction.native import shared_out
from reconstruction.rendering.bent import seen_through
from reconstruction.scene_model import SceneModel, View
from reconstruction.truth import Truth, TruthFrame, spread
from rigs.camera import Camera
from rigs.similarity import align

INSTANTS = 8  # truth instants that a run is scored on
Posed = tuple[Camera, CompositeSource]
Image = NDArray[np.float32]
COUNT_WINDOW = 32  # planes that a count error is taken over
PLACING_WINDOWS = 4  # windows of spikes that a camera is placed by


@dataclass(frozen=True)
class HeldOut:
    """The camera that is scored, and the recording it belongs to.

    `resected`: whether odd windows of its spikes have placed it or told its `gain`, so that even ones are left to score
    it. Counts are over that gain.
    """

    camera: Camera
    recording: Recording
    resected: bool = False
    gain: float = 1.0

    def windows(self) -> tuple[int, list[int]]:
        """Return how many planes a window has, and the first planes of those to score on."""
        planes = len(self.recording.stream(self.camera.id))
        window = max(1, min(COUNT_WINDOW, planes // 2 if self.resected else planes))
        return window, list(range(0, planes - window + 1, window * (2 if self.resected else 1)))

    def told(self, most: int) -> list[tuple[float, NDArray[np.float32]]]:
        """Return the instants (s) and the light of at most so many odd windows, on which it is not scored."""
        odd = replace(self, resected=True)
        (window, even), planes = odd.windows(), len(self.recording.stream(self.camera.id))
        firsts = spread([first + window for first in even if first + 2 * window <= planes], most)
        clock = self.recording.rig.clock
        return [(clock.instant_s(f + (window - 1) / 2), self.rate(f, f + window)) for f in firsts]

    def rate(self, first: int, last: int) -> NDArray[np.float32]:
        """Return the light [H, W] that planes [first, last) count, spikes per tick, evened out where maps are known."""
        counts = self.recording.stream(self.camera.id).counts(first, last)
        rate = (counts / ((last - first) * self.gain)).astype(np.float32)
        maps = self.recording.rig.camera(self.camera.id).pixels
        return Response.calibrated(read_pixels(maps)).mended(rate, 1) if maps else rate


def score_against_truth(
    cloud: SceneModel, held_out: HeldOut, truth: Truth, instants: int = INSTANTS
) -> dict[str, float]:
    """Return means over at most `instants` truth instants: psnr_db, ssim, abs_rel, delta_1_25, and dynamic_ of each."""
    return score_at(cloud, held_out, truth, _planes(held_out, truth, instants))


def score_at(cloud: SceneModel, held_out: HeldOut, truth: Truth, planes: Sequence[int]) -> dict[str, float]:
    """Return the means of the same scores over `planes` that have truth."""
    clock = held_out.recording.rig.clock

    def scored(plane: int) -> dict[str, float]:
        frame = _frame(held_out, truth, plane)
        view = cloud.look(held_out.camera, clock.instant_s(plane - truth.lag_ticks))
        return score_view(view, frame, truth.white)

    return _mean(list(shared_out(scored, planes)))


def score_floors(
    held_out: HeldOut, truth: Truth, sources: Mapping[str, Posed], progress: Progress = silent
) -> dict[str, float]:
    """Return the same metrics of both floors, named nearest_view.* and depth_blend.*, on the same instants."""
    cameras, planes = [camera for camera, _ in sources.values()], _planes(held_out, truth, INSTANTS)
    near, span_m = [list(sources.values())[i] for i in neighbours(held_out.camera, cameras)], depth_range_m(cameras)

    def scored(instant: tuple[int, Sequence[tuple[Camera, Image]]]) -> tuple[dict[str, float], dict[str, float]]:
        frame, views = _frame(held_out, truth, instant[0]), instant[1]
        nearest = seen_through(held_out.camera, lambda pinhole: nearest_view(pinhole, views))
        blend = seen_through(held_out.camera, lambda pinhole: depth_blend(pinhole, views, span_m))
        plain = {k: v for k, v in score_view(nearest, frame, truth.white).items() if "delta" not in k}
        return plain, score_view(blend, frame, truth.white)  # the nearest view knows no depth

    last = held_out.recording.planes - 1
    seen = {plane: min(max(round(plane - truth.lag_ticks), 0), last) for plane in planes}  # at the instant of the truth
    views = ((plane, [(camera, source.at(seen[plane])) for camera, source in near]) for plane in planes)
    rows = []
    for row in shared_out(scored, views):
        rows.append(row)
        progress(len(rows) / len(planes), f"floors at instant {len(rows)} of {len(planes)}")
    named = zip(("nearest_view", "depth_blend"), zip(*rows, strict=True), strict=True)
    return {f"{name}.{key}": value for name, scores in named for key, value in _mean(scores).items()}


def score_against_counts(cloud: SceneModel, held_out: HeldOut) -> dict[str, float]:
    """Return errors of spike counts over 32-plane windows of the held-out camera, in spikes, where no truth exists."""
    clock = held_out.recording.rig.clock
    window, firsts = held_out.windows()

    def gap(first: int) -> Image:
        expected = cloud.look(held_out.camera, clock.instant_s(first + (window - 1) / 2)).intensity * window
        return expected - held_out.rate(first, first + window) * window

    gaps = np.stack(list(shared_out(gap, spread(firsts, INSTANTS))))
    return {"counts.mae": float(np.abs(gaps).mean()), "counts.rmse": float(np.sqrt((gaps**2).mean()))}


def held_out_camera(
    recording: Recording, camera_id: str, views: Sequence[str], truth: Truth | None
) -> tuple[HeldOut, Truth | None]:
    """Return the camera to score and the truth to score against, both in the frame of the cameras `views` that trained.

    With truth it is the true camera, carried by the similarity that lays the true `views` on those of the recording's
    rig, with the factor of the focal length that those were found with; where they are the true ones, nothing changes.
    The truth is in the light and on the clock that `views` have on average. No spike of the camera itself is read.
    """
    rig = recording.rig
    true = truth.cameras(rig.tick_rate_hz) if truth else None
    if truth is None or true is None or not {camera_id, *views} <= set(true.ids):
        return HeldOut(rig.camera(camera_id), recording), truth and truth.seen_by(views)
    similarity = align(true.only(views), rig.only(views))
    camera = similarity.carry_rig(true.only([camera_id])).cameras[0]
    factor = float(np.mean([rig.camera(view).fx / true.camera(view).fx for view in views]))
    lens = {"fx": camera.fx * factor, "fy": camera.fy * factor}
    return HeldOut(replace(camera, **lens), recording), replace(truth.seen_by(views), metre=similarity.scale)


def placed_by_spikes(cloud: SceneModel, held_out: HeldOut) -> HeldOut:
    """Return the held-out camera where odd windows of its spikes place it in the finished scene `cloud`."""
    pinhole = view_of(held_out.camera)
    way = straightening(held_out.camera, pinhole) if held_out.camera.bends else None
    told = held_out.told(PLACING_WINDOWS)
    counted = [Counted(at_s, light if way is None else way.light(light)) for at_s, light in told]
    if not counted:
        return held_out
    place = resected(cloud, pinhole, counted, None if way is None else way.covered).cam_from_rig
    return replace(held_out, camera=replace(held_out.camera, cam_from_rig=place), resected=True)


def gained_by_spikes(cloud: SceneModel, held_out: HeldOut) -> HeldOut:
    """Return the held-out camera with the gain that odd windows of its spikes have over the finished scene `cloud`."""
    ratios = []
    for instant_s, light in held_out.told(PLACING_WINDOWS):
        shown = cloud.look(held_out.camera, instant_s).intensity
        pixels = np.minimum(light, shown) > DARKEST
        ratios += [float(np.median(np.log(light[pixels] / shown[pixels])))] if pixels.any() else []
    return replace(held_out, gain=float(np.exp(np.mean(ratios))), resected=True) if ratios else held_out


def score_view(view: View, frame: TruthFrame, white: float) -> dict[str, float]:
    """Return the scores of one picture against the truth: over all pixels, and dynamic_ of each over moving ones.

    They are psnr_db, ssim, abs_rel and delta_1_25; `white` is the data range in spikes per tick.
    """
    scores: dict[str, float] = {}
    alike = ssim_map(view.intensity, frame.intensity, white)
    masks: dict[str, NDArray[np.bool_] | None] = {"": None, "dynamic_": frame.moving}
    for prefix, mask in masks.items():
        scores[f"{prefix}psnr_db"] = psnr_db(view.intensity, frame.intensity, white, mask)
        scores[f"{prefix}ssim"] = mean_over(alike, mask)
        scores[f"{prefix}abs_rel"] = abs_rel(view.depth, frame.depth, mask)
        scores[f"{prefix}delta_1_25"] = delta_1_25(view.depth, frame.depth, mask)
    return scores


def _planes(held_out: HeldOut, truth: Truth, instants: int) -> list[int]:
    return spread(truth.planes(held_out.camera.id), instants)


def _frame(held_out: HeldOut, truth: Truth, plane: int) -> TruthFrame:
    """Return the truth at a plane; raises BadRunError for one of another size than the camera records."""
    camera = held_out.camera
    frame, expected = truth.frame(camera.id, plane), (camera.height, camera.width)
    if frame.intensity.shape != expected:
        raise BadRunError(f"found truth of shape {frame.intensity.shape}", f"{expected} as {camera.id} records")
    return frame


def _mean(rows: Sequence[dict[str, float]]) -> dict[str, float]:
    """Return the mean of each score over the instants that have it; a score that no instant has is left out."""
    means = {}
    for key in rows[0]:
        values = [row[key] for row in rows if np.isfinite(row[key])]
        if values:
            means[key] = float(np.mean(values))
    return means
