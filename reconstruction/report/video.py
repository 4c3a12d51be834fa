"""Writes pictures as an H.264 video, whole or not at all."""

from collections.abc import Iterable
from pathlib import Path

import av
import numpy as np

from acquisition.durable import made_aside
from reconstruction.report.display import Pixels

RATE_HZ = 24  # pictures a second
VIDEO = {"preset": "veryfast", "crf": "18", "movflags": "+faststart"}  # half of the default preset's time, as good


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
