"""Light and metres in false colour, and pictures as PNG."""

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from acquisition.durable import write_durably
from reconstruction.errors import ReconstructionError
from reconstruction.report.display import Pixels
from rigs.camera import Camera

MOST_PX = 400_000  # pixels of a picture that is looked at in passing


def of_moderate_size(camera: Camera, most_px: int | None = None) -> Camera:
    """Return the camera, halved until it has `most_px` pixels or fewer; by default MOST_PX."""
    while camera.width * camera.height > (most_px or MOST_PX):
        camera = camera.halved()
    return camera


def error_colours(error: NDArray[np.float32], white: float) -> Pixels:
    """Return the size of errors [H, W] in false colour [H, W, 3]; full scale is a fifth of `white`."""
    scaled = np.clip(np.abs(error) / max(white, 1e-9) * 5, 0, 1)
    return np.asarray(cv2.applyColorMap(np.round(scaled * 255).astype(np.uint8), cv2.COLORMAP_INFERNO), np.uint8)


def depth_colours(depth: NDArray[np.float32], near_m: float, far_m: float) -> Pixels:
    """Return depth [H, W] in false colour [H, W, 3] (near is warm), uniform in inverse depth; black where unknown."""
    known = np.isfinite(depth) & (depth > 0)
    inverse = np.where(known, 1 / np.where(known, depth, 1), 0)
    scaled = np.clip((inverse - 1 / far_m) / max(1 / near_m - 1 / far_m, 1e-9), 0, 1)
    colours = np.asarray(cv2.applyColorMap(np.round(scaled * 255).astype(np.uint8), cv2.COLORMAP_TURBO), np.uint8)
    colours[~known] = 0
    return colours


def encode_png(pixels: Pixels) -> bytes:
    """Return a PNG of 8-bit grey [H, W] or BGR [H, W, 3]."""
    done, data = cv2.imencode(".png", pixels)
    if not done:
        raise ReconstructionError(f"found an image of shape {pixels.shape} that cannot be encoded as PNG")
    return data.tobytes()


def write_png(path: Path, pixels: Pixels) -> None:
    """Write a PNG durably."""
    write_durably(path, encode_png(pixels))
