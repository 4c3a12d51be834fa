"""Depth maps: `NNNNNN.npy` (float32 [H, W], m along z, NaN where nothing is), and `NNNNNN.png` in colours."""

from __future__ import annotations

from pathlib import Path

from acquisition.durable import write_array
from acquisition.progress import Progress
from reconstruction.export.scene import Choices, Scene
from reconstruction.report.pictures import depth_colours, depth_span_m, write_png


def write_depth(folder: Path, scene: Scene, choices: Choices, progress: Progress) -> dict:
    """What the camera chosen sees at even instants; all pictures share one scale, that of the clip's middle."""
    folder.mkdir()
    camera, instants, frames = scene.camera(choices), scene.instants_s(choices), []
    near, far = depth_span_m(scene.cloud.look(camera, scene.middle_s).depth)
    for i, instant_s in enumerate(instants):
        depth = scene.cloud.look(camera, instant_s).depth
        file = f"{i:06d}.npy"
        write_array(folder / file, depth)
        write_png(folder / f"{i:06d}.png", depth_colours(depth, near, far))
        frames.append({"file": file, "instant_s": instant_s})
        progress((i + 1) / len(instants), f"frame {i + 1} of {len(instants)}")
    return {"camera": camera.id, "colours_m": [near, far], "frames": frames}
