"""Videos in H.264, and the fly-through: the camera circles inside the array's opening while the clip plays."""

import math
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import av
import numpy as np

from acquisition.durable import made_aside
from acquisition.progress import Progress
from reconstruction.native import shared_out
from reconstruction.report.display import Pixels, depth_span_m, grey
from reconstruction.report.pictures import depth_colours, of_moderate_size
from reconstruction.scene_model import SceneModel, TimeSpan
from reconstruction.uncertainty.expected_error import Uncertainty
from rigs.camera import Camera
from rigs.rig import Rig
from rigs.transform import Transform

RATE_HZ = 24  # pictures a second
VIDEO = {"preset": "veryfast", "crf": "18", "movflags": "+faststart"}  # half of the default preset's time, as good
FRAMES = 120  # of the fly-through
PROBES, SMALL_PX = 8, 10_000  # places on the circle whose expected error is asked for, and the pixels of each
SHARES = (0.8, 0.6, 0.4, 0.2)  # shares of the array's half width that the circle may have, the widest first
TRUSTED = 2.0  # times the error expected at the circle's centre that is trusted on it


def orbit_cameras(
    rig: Rig, centre: Camera, distance_m: float, frames: int = FRAMES, share: float = SHARES[0]
) -> Iterator[Camera]:
    """Yield cameras on an ellipse around `centre`, in its image plane, that look at a point `distance_m` ahead.

    `share`: the ellipse's half axes, over the half width and height of the array.
    """
    world_from_centre = centre.cam_from_rig.inverse()
    spots = centre.cam_from_rig.apply(np.stack([c.center for c in rig.cameras]))
    radius = share * np.abs(spots).max(axis=0)
    target = world_from_centre.apply([0, 0, distance_m])
    down = world_from_centre.rotation[:, 1]
    for i in range(frames):
        angle = 2 * math.pi * i / frames
        spot = world_from_centre.apply([radius[0] * math.cos(angle), radius[1] * math.sin(angle), 0])
        yield replace(centre, cam_from_rig=Transform.looking_at(spot, target, down))


def trusted_share(uncertainty: Uncertainty, rig: Rig, centre: Camera) -> float:
    """Return the widest of SHARES on whose ellipse the expected error stays within TRUSTED times that at its centre."""
    at_s, small = uncertainty.scene.clip.middle_s, of_moderate_size(centre, SMALL_PX)
    distance_m = _middle_m(*depth_span_m(uncertainty.scene.look(small, at_s).depth))
    most = TRUSTED * float(uncertainty.look(small, at_s).mean())
    for share in SHARES[:-1]:
        cameras = orbit_cameras(rig, small, distance_m, PROBES, share)
        if max(shared_out(lambda camera: float(uncertainty.look(camera, at_s).mean()), cameras)) <= most:
            return share
    return SHARES[-1]


def _middle_m(near_m: float, far_m: float) -> float:
    """Return the middle of two depths in inverse metres, m: how far ahead of its centre an ellipse looks."""
    return 2 / (1 / near_m + 1 / far_m)


def write_orbit(
    path: Path,
    cloud: SceneModel,
    rig: Rig,
    centre: Camera,
    white: float,
    progress: Progress,
    *,
    frames: int = FRAMES,
    clip: TimeSpan | None = None,
    share: float = SHARES[0],
) -> None:
    """Write an H.264 video at `path`, intensity beside depth; `clip`, by default all, plays once over the circle.

    Pictures are as large as those of `centre`, or of moderate size. `share` is that of `orbit_cameras`.
    """
    clip, centre = clip or cloud.clip, of_moderate_size(centre)
    near, far = depth_span_m(cloud.look(centre, clip.middle_s).depth)
    distance_m = _middle_m(near, far)

    def picture(frame: tuple[int, Camera]) -> Pixels:
        view = cloud.look(frame[1], clip.instant_s(frame[0] / max(1, frames - 1)))
        return side_by_side(grey(view.intensity, white), depth_colours(view.depth, near, far))

    def pictures() -> Iterator[Pixels]:
        shown = shared_out(picture, enumerate(orbit_cameras(rig, centre, distance_m, frames, share)))
        for i, pixels in enumerate(shown):
            yield pixels
            progress((i + 1) / frames, f"orbit frame {i + 1} of {frames}")

    write_video(path, (4 * (centre.width // 2), centre.height), pictures())


def side_by_side(left: Pixels, right: Pixels) -> Pixels:
    """Return grey [H, W] beside BGR [H, W, 3], each of an even width, as BGR."""
    width = 2 * (left.shape[1] // 2)
    return np.hstack([np.repeat(left[:, :width, None], 3, axis=2), right[:, :width]])


def write_video(path: Path, size: tuple[int, int], pictures: Iterable[Pixels]) -> None:
    """Write 8-bit grey [H, W] or BGR [H, W, 3] pictures of `size` (width, height) at `path`, RATE_HZ a second.

    H.264 halves the colours' resolution, so an odd last row or column is left out.
    """
    width, height = (2 * (length // 2) for length in size)
    with made_aside(path) as aside, av.open(str(aside), "w", format="mp4") as container:
        stream = container.add_stream("libx264", rate=RATE_HZ, options=VIDEO)
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        for picture in pictures:
            pixels, form = np.ascontiguousarray(picture[:height, :width]), "gray" if picture.ndim == 2 else "bgr24"
            container.mux(stream.encode(av.VideoFrame.from_ndarray(pixels, format=form)))
        container.mux(stream.encode(None))
