"""A fly-through: the camera circles inside the array's opening while the clip plays."""

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import av
import numpy as np

from acquisition.progress import Progress
from reconstruction.gaussians.dynamic import DynamicCloud
from reconstruction.rendering.view import look
from reconstruction.report.pictures import Pixels, depth_colours, depth_span_m, grey
from rigs.camera import Camera
from rigs.rig import Rig
from rigs.transform import Transform

FRAMES = 120
RATE_HZ = 24
VIDEO = {"preset": "veryfast", "crf": "18", "movflags": "+faststart"}  # half of the default preset's time, as good
SHARE = 0.8  # of the array's half width: inside what the cameras saw


def orbit_cameras(rig: Rig, centre: Camera, distance_m: float, frames: int = FRAMES) -> Iterator[Camera]:
    """Cameras on an ellipse around `centre`, in its image plane, all looking at the point `distance_m` ahead of it."""
    world_from_centre = centre.cam_from_rig.inverse()
    spots = centre.cam_from_rig.apply(np.stack([c.center for c in rig.cameras]))
    radius = SHARE * np.abs(spots).max(axis=0)
    target = world_from_centre.apply([0, 0, distance_m])
    down = world_from_centre.rotation[:, 1]
    for i in range(frames):
        angle = 2 * math.pi * i / frames
        spot = world_from_centre.apply([radius[0] * math.cos(angle), radius[1] * math.sin(angle), 0])
        yield replace(centre, cam_from_rig=Transform.looking_at(spot, target, down))


def write_orbit(path: Path, cloud: DynamicCloud, rig: Rig, centre: Camera, white: float, progress: Progress) -> None:
    """Write an H.264 video at `path`, intensity beside depth; the clip plays once over the circle."""
    middle = look(cloud, centre, (cloud.clip.first_s + cloud.clip.last_s) / 2)
    near, far = depth_span_m(middle.depth)
    distance = 2 / (1 / near + 1 / far)
    aside = path.with_name(f".{path.name}.partial")
    with av.open(str(aside), "w", format="mp4") as container:
        stream = container.add_stream("libx264", rate=RATE_HZ, options=VIDEO)
        stream.width, stream.height, stream.pix_fmt = 4 * (centre.width // 2), 2 * (centre.height // 2), "yuv420p"
        for i, camera in enumerate(orbit_cameras(rig, centre, distance)):
            share = i / (FRAMES - 1)
            view = look(cloud, camera, cloud.clip.first_s + share * (cloud.clip.last_s - cloud.clip.first_s))
            pixels = _side_by_side(grey(view.intensity, white), depth_colours(view.depth, near, far))
            frame = av.VideoFrame.from_ndarray(pixels[: stream.height, : stream.width], format="bgr24")
            container.mux(stream.encode(frame))
            progress((i + 1) / FRAMES, f"orbit frame {i + 1} of {FRAMES}")
        container.mux(stream.encode(None))
    aside.replace(path)


def _side_by_side(left: Pixels, right: Pixels) -> Pixels:
    width = 2 * (left.shape[1] // 2)
    both = [np.repeat(left[:, :width, None], 3, axis=2), right[:, :width]]
    return np.ascontiguousarray(np.hstack(both), dtype=np.uint8)
