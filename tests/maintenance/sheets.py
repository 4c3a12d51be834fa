"""Contact sheets of the scenes, to be looked at: three instants, depth and objects of the centre camera in one PNG.

`PYTHONPATH=tests python -m maintenance.sheets --out DIR [--seed S] [NAME...]` writes DIR/NAME.png for the scenes
named, or all that need no extra and may be looked at; `make sheets` writes all to runs/sheets.
"""

from pathlib import Path

import click
import numpy as np
from numpy.typing import NDArray

from acquisition.scenes.catalog import (
    DEVELOPMENT_SEEDS,
    LONG_EVALUATION,
    REALISTIC,
    REALISTIC_EVALUATION,
    REALISTIC_LONG,
    REALISTIC_LONG_EVALUATION,
    SCENES,
    build_scene,
)
from acquisition.scenes.scene import Scene
from reconstruction.report.display import grey
from reconstruction.report.pictures import depth_colours, write_png
from rigs.toml import catalog_rig

INSTANTS_S = (0.000025, 0.012525, 0.019975)  # of a clip of 400 planes; the light of `flicker` differs in them
NEAR_M, FAR_M = 1.0, 3.6


def contact_sheet(scene: Scene) -> NDArray[np.uint8]:
    """Light at three instants above depth (near is warm), objects and what moves, at the first [2 H, 3 W, 3]."""
    camera = catalog_rig("lab3x3").camera("cam11")
    frames = scene.render(camera, np.array(INSTANTS_S))
    light = np.hstack([grey(image, scene.white) for image in frames.intensity])
    objects = (frames.ids[0].astype(int) * 53 % 256).astype(np.uint8)
    moving = np.where(np.isin(frames.ids[0], list(scene.movers.values())), 255, 0).astype(np.uint8)
    below = [depth_colours(frames.depth[0], NEAR_M, FAR_M), _three(objects), _three(moving)]
    return np.vstack([_three(light), np.hstack(below)])


def _three(pixels: NDArray[np.uint8]) -> NDArray[np.uint8]:
    return np.repeat(pixels[..., None], 3, axis=-1)


@click.command()
@click.option("--out", type=click.Path(path_type=Path), required=True, help="Folder for the pictures.")
@click.option("--seed", default=DEVELOPMENT_SEEDS[0], show_default=True, type=click.IntRange(min=0))
@click.argument("names", nargs=-1, type=click.Choice(tuple(SCENES)))
def main(out: Path, seed: int, names: tuple[str, ...]) -> None:
    """Write one picture a scene."""
    out.mkdir(parents=True, exist_ok=True)
    apart = (*REALISTIC, *REALISTIC_EVALUATION, *LONG_EVALUATION, *REALISTIC_LONG, *REALISTIC_LONG_EVALUATION)
    for name in names or [name for name in SCENES if name not in apart]:
        write_png(out / f"{name}.png", contact_sheet(build_scene(name, seed)))


if __name__ == "__main__":
    main()
