"""nerfstudio's `transforms.json` with `images/camRC_NNNNNN.png` and `points.ply`: the run's data for another trainer.

There is a frame for each training camera at each of some even planes: the image the run learnt from, not the one it
renders, with gamma 2.2 over white. The held-out camera is left out. `time` is in seconds on the rig clock.
`points.ply` is `ply` at the instant chosen. Source: nerfstudio documentation, "Data conventions".
"""

from pathlib import Path

from acquisition.durable import write_durably
from acquisition.progress import Progress
from reconstruction.export.formats.ply import ply_bytes
from reconstruction.export.scene import TICKS, Choices, Format, Scene
from reconstruction.export.splats import splats_at
from reconstruction.report.display import grey
from rigs.exchange.nerfstudio import Frame, dump_frames

POINTS = "points.ply"


def write_nerfstudio(folder: Path, scene: Scene, choices: Choices, progress: Progress) -> dict:
    """Write the target images of the training cameras at even planes, with cameras, times and points."""
    from reconstruction.report.pictures import write_png

    clock = scene.rig.clock
    planes = sorted({clock.plane(instant_s) for instant_s in scene.instants_s(choices)})
    (folder / "images").mkdir(parents=True)
    targets = scene.targets()
    frames, pictures = [], []
    for view, source in targets.items():
        for plane in planes:
            picture = f"images/{view}_{clock.first_tick + plane:06d}.png"
            write_png(folder / picture, grey(source.at(plane), scene.white))
            frames.append(Frame(scene.rig.camera(view), clock.instant_s(plane)))
            pictures.append(picture)
            progress(len(frames) / (len(targets) * len(planes)), picture)
    write_durably(folder / POINTS, ply_bytes(splats_at(scene, scene.instant_s(choices))))
    write_durably(folder / "transforms.json", dump_frames(frames, pictures, POINTS))
    return {"planes": [clock.first_tick + plane for plane in planes]}


NERFSTUDIO = Format(
    "nerfstudio",
    "`transforms.json` with times, the target images of the training cameras, `points.ply`",
    "nerfstudio",
    write_nerfstudio,
    ("at_s", "frames", *TICKS),
)
