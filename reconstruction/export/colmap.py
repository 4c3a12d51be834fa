"""A COLMAP text model with pictures: `images/camRC.png` and `sparse/0/{cameras,images,points3D}.txt`.

Every camera of the rig, the held-out one too, with what the run shows from there at one instant (rendered). The world
is the rig frame. Points are the Gaussians' means with their display grey; none has a track.
Source: COLMAP documentation, "Output format".
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from acquisition.durable import write_durably
from acquisition.progress import Progress
from reconstruction.export.scene import Choices, Scene, splats_at
from reconstruction.report.pictures import grey, write_png
from rigs.exchange.colmap import dump_model, dump_points


def write_colmap(folder: Path, scene: Scene, choices: Choices, progress: Progress) -> dict:
    """The rig's cameras, their pictures at one instant, and the Gaussians there as points."""
    instant_s = scene.instant_s(choices)
    model, pictures = folder / "sparse" / "0", folder / "images"
    model.mkdir(parents=True)
    pictures.mkdir()
    splats = splats_at(scene, instant_s)
    greys = np.round(np.clip(splats.display(), 0, 1) * 255).astype(np.uint8)
    files = dump_model(scene.rig.cameras) | {"points3D.txt": dump_points(splats.means, greys)}
    for name, text in files.items():
        write_durably(model / name, text)
    for i, camera in enumerate(scene.rig.cameras):
        write_png(pictures / f"{camera.id}.png", grey(scene.cloud.look(camera, instant_s).intensity, scene.white))
        progress((i + 1) / len(scene.rig.cameras), camera.id)
    return {"instant_s": instant_s}
