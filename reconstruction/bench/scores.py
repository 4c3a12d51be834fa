"""Scores single images for the image bench: errors against the truth, and naturalness without one."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from reconstruction.bench.streams import TrueImage
from reconstruction.metrics.image import psnr_db, ssim
from reconstruction.metrics.lpips import Lpips
from reconstruction.metrics.natural import Niqe, brisque
from reconstruction.metrics.sharpness import edge_sharpness
from reconstruction.report.display import grey

Image = NDArray[np.float32]
FILES = {  # parameters of each metric that has some
    "lpips": ("alexnet*.pth",),
    "brisque": ("brisque_model_live.yml", "brisque_range_live.yml"),
    "niqe": ("niqe_pris_params.npz",),
}
DEFINITIONS = (
    "PSNR over linear intensity with the scene's white as data range, SSIM with a Gaussian window of 1.5 pixels and "
    "population covariance over the same range; dynamic_ over the pixels that see a mover at the instant"
)


class Scorer:
    """The metrics whose parameters are in `folder`; `omissions` names the others; BadRunError for broken ones."""

    def __init__(self, folder: Path | None) -> None:
        files = {name: [sorted(folder.glob(p)) if folder else [] for p in FILES[name]] for name in FILES}
        known = {name: [paths[0] for paths in found] for name, found in files.items() if all(found)}
        self.omissions = tuple(
            f"{name}: found no {' and '.join(FILES[name])} in --metric-files" for name in FILES if name not in known
        )
        self._lpips = Lpips(*known["lpips"]) if "lpips" in known else None
        self._natural: dict[str, Callable[[NDArray[np.uint8]], float]] = {}
        if "brisque" in known:
            model, spans = known["brisque"]
            self._natural["brisque"] = partial(brisque, model=model, spans=spans)
        if "niqe" in known:
            self._natural["niqe"] = Niqe(*known["niqe"])

    def against(self, image: Image, truth: TrueImage) -> dict[str, float]:
        """Return the errors of an image [H, W] in spikes per tick, and its naturalness."""
        found = {
            "psnr_db": psnr_db(image, truth.light, truth.white),
            "ssim": ssim(image, truth.light, truth.white),
            "dynamic_psnr_db": psnr_db(image, truth.light, truth.white, truth.moves),
            "static_psnr_db": psnr_db(image, truth.light, truth.white, ~truth.moves),
            "edge_sharpness": edge_sharpness(image, truth.light, truth.moves),
        }
        if self._lpips:
            display = [(grey(a, truth.white) / np.float32(255)).astype(np.float32) for a in (image, truth.light)]
            found["lpips"] = self._lpips(*display)
        return found | self.alone(image, truth.white)

    def alone(self, image: Image, white: float) -> dict[str, float]:
        """Return the naturalness of an image [H, W] as a person would see it; `white` is shown as white."""
        pixels = grey(image, white)
        return {name: judge(pixels) for name, judge in self._natural.items()}
