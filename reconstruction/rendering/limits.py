"""Reads the cameras that a run is asked to be rendered from, and refuses what no machine should be asked for."""

from pathlib import Path

from rigs.errors import RigError
from rigs.exchange.nerfstudio import Frame, load_frames

MOST_PIXELS = 1 << 25  # of one picture
MOST_PIXELS_TOGETHER = 1 << 32


def frames_to_render(path: Path) -> list[Frame]:
    """Read the cameras of a `transforms.json`; raises RigError where it cannot be read or asks for too many pixels."""
    frames = load_frames(path)
    together = 0
    for number, frame in enumerate(frames):
        pixels = frame.camera.width * frame.camera.height
        together += pixels
        if pixels > MOST_PIXELS:
            found = f"found a picture of {frame.camera.width}x{frame.camera.height}"
            raise RigError(found, f"at most {MOST_PIXELS} pixels", "render it smaller", where=f"frame {number}")
    if together > MOST_PIXELS_TOGETHER:
        found = f"found {len(frames)} frames of {together} pixels together"
        raise RigError(found, f"at most {MOST_PIXELS_TOGETHER}", "render them in parts", where=path.name)
    return frames
