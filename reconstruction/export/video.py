"""An H.264 video of the clip, played once: from a camera of the rig, or from an orbit inside the rig's opening."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from acquisition.progress import Progress
from reconstruction.export.scene import Choices, Scene
from reconstruction.report.orbit import FRAMES as ORBIT_FRAMES
from reconstruction.report.orbit import write_orbit
from reconstruction.report.pictures import Pixels, grey
from reconstruction.report.video import write_video as encode


def write_video(path: Path, scene: Scene, choices: Choices, progress: Progress) -> dict:
    """Grey pictures from the camera chosen; without one the orbit of the report, with depth beside the picture."""
    camera = scene.camera(choices)
    if choices.camera is None:
        frames = choices.frames or ORBIT_FRAMES
        write_orbit(path, scene.cloud, scene.rig, camera, scene.white, progress, frames=frames)
        return {}
    instants = scene.instants_s(choices)

    def pictures() -> Iterator[Pixels]:
        for i, instant_s in enumerate(instants):
            yield grey(scene.cloud.look(camera, instant_s).intensity, scene.white)
            progress((i + 1) / len(instants), f"frame {i + 1} of {len(instants)}")

    encode(path, (camera.width, camera.height), pictures())
    return {}
