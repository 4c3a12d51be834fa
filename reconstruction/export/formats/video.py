"""An H.264 video of the clip, played once: from a camera of the rig, or from an orbit inside the rig's opening."""

from collections.abc import Iterator
from pathlib import Path

from acquisition.progress import Progress
from reconstruction.export.scene import TICKS, Choices, Format, Scene
from reconstruction.report.display import Pixels, grey


def write_video(path: Path, scene: Scene, choices: Choices, progress: Progress) -> dict:
    """Write grey pictures from the camera chosen; without one the report's orbit, with depth beside the picture."""
    from reconstruction.report import video

    camera = scene.camera(choices)
    if choices.camera is None:
        frames = choices.frames or video.FRAMES
        how = {"frames": frames, "clip": scene.clip}
        video.write_orbit(path, scene.cloud, scene.rig, camera, scene.white, progress, **how)
        return {}

    def pictures() -> Iterator[Pixels]:
        for _, instant_s in scene.frames(choices, progress):
            yield grey(scene.cloud.look(camera, instant_s).intensity, scene.white)

    video.write_video(path, (camera.width, camera.height), pictures())
    return {}


VIDEO = Format(
    "video",
    "H.264 from a camera of the rig; without one the report's orbit, with depth",
    "scene.mp4",
    write_video,
    ("frames", "camera", *TICKS),
)
