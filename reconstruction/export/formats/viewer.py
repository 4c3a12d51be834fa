"""The two files that the viewer's page plays; `reconstruction.export.viewer` says what is in them."""

from pathlib import Path

from acquisition.progress import Progress
from reconstruction.export.scene import TICKS, Choices, Format, Scene


def export_viewer(folder: Path, scene: Scene, choices: Choices, progress: Progress) -> dict:
    """Write `viewer.json` and `viewer.bin` into a folder of their own."""
    from reconstruction.export.viewer import write_viewer

    folder.mkdir()
    write_viewer(folder, scene)
    progress(1.0, f"{len(scene.cloud)} Gaussians")
    return {}


VIEWER = Format(
    "viewer",
    "`viewer.json`, `viewer.bin`: what a browser plays in 4D, span by span; the report stage writes them too",
    "viewer",
    export_viewer,
    TICKS,
    served=False,
)
