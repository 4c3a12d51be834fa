"""A folder of `.ply` files over the clip, as `formats.ply` writes them."""

from pathlib import Path

from acquisition.durable import write_durably
from acquisition.progress import Progress
from reconstruction.export.formats.ply import ply_bytes
from reconstruction.export.scene import TICKS, Choices, Format, Scene
from reconstruction.export.splats import splats_at


def write_ply_sequence(folder: Path, scene: Scene, choices: Choices, progress: Progress) -> dict:
    """Write `NNNNNN.ply` at even instants; the manifest has the seconds of each."""
    folder.mkdir()
    frames = []
    for number, instant_s in scene.frames(choices, progress):
        write_durably(folder / f"{number}.ply", ply_bytes(splats_at(scene, instant_s)))
        frames.append({"file": f"{number}.ply", "instant_s": instant_s})
    return {"frames": frames}


PLY_SEQUENCE = Format(
    "ply-sequence",
    "`NNNNNN.ply` over the clip, their instants in `manifest.json`",
    "ply",
    write_ply_sequence,
    ("frames", *TICKS),
)
