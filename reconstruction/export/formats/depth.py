"""Depth maps: `NNNNNN.npy` (float32 [H, W], m along z, NaN where nothing is), and `NNNNNN.png` in colours."""

from pathlib import Path

from acquisition.arrays import write_array
from acquisition.progress import Progress
from reconstruction.export.scene import TICKS, Choices, Format, Scene
from reconstruction.report.display import depth_span_m


def write_depth(folder: Path, scene: Scene, choices: Choices, progress: Progress) -> dict:
    """Write the depths that the camera chosen sees at even instants; pictures share the scale of the middle."""
    from reconstruction.report.pictures import depth_colours, write_png

    folder.mkdir()
    camera, frames = scene.camera(choices), []
    near, far = depth_span_m(scene.cloud.look(camera, scene.clip.middle_s).depth)
    for number, instant_s in scene.frames(choices, progress):
        depth = scene.cloud.look(camera, instant_s).depth
        write_array(folder / f"{number}.npy", depth)
        write_png(folder / f"{number}.png", depth_colours(depth, near, far))
        frames.append({"file": f"{number}.npy", "instant_s": instant_s})
    return {"camera": camera.id, "colours_m": [near, far], "frames": frames}


DEPTH = Format(
    "depth", "depth maps in m (NaN where nothing is) and in colours", "depth", write_depth, ("frames", "camera", *TICKS)
)
