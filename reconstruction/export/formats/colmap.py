"""A COLMAP text model with pictures: `images/camRC.png` and `sparse/0/{cameras,images,points3D}.txt`.

Every camera of the rig is there, the held-out one too, with the picture that the run renders from it at one instant.
The world is the rig frame. Points are the Gaussians' means with their display grey; none has a track.
Source: COLMAP documentation, "Output format".
"""

from pathlib import Path

from acquisition.durable import write_durably
from acquisition.progress import Progress
from reconstruction.export.scene import Choices, Format, Scene
from reconstruction.export.splats import splats_at, to_bytes
from reconstruction.report.display import grey
from rigs.exchange.colmap import dump_model, dump_points


def write_colmap(folder: Path, scene: Scene, choices: Choices, progress: Progress) -> dict:
    """Write the rig's cameras, their pictures at one instant, and the Gaussians there as points."""
    from reconstruction.report.pictures import write_png

    instant_s = scene.instant_s(choices)
    model, pictures = folder / "sparse" / "0", folder / "images"
    model.mkdir(parents=True)
    pictures.mkdir()
    splats = splats_at(scene, instant_s)
    greys = to_bytes(255 * splats.display())
    files = dump_model(scene.rig.cameras) | {"points3D.txt": dump_points(splats.means, greys)}
    for name, text in files.items():
        write_durably(model / name, text)
    for i, camera in enumerate(scene.rig.cameras):
        write_png(pictures / f"{camera.id}.png", grey(scene.cloud.look(camera, instant_s).intensity, scene.white))
        progress((i + 1) / len(scene.rig.cameras), camera.id)
    return {"instant_s": instant_s}


COLMAP = Format(
    "colmap", "text model, a rendered picture a camera, the Gaussians as points", "colmap", write_colmap, ("at_s",)
)
