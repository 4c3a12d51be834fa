"""What the image bench says of one image: errors against truth, naturalness without, and what there is no means for."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from reconstruction.bench.clips import Truth
from reconstruction.metrics.image import psnr_db, ssim
from reconstruction.metrics.lpips import Lpips
from reconstruction.metrics.natural import Niqe, brisque
from reconstruction.metrics.sharpness import edge_sharpness
from reconstruction.report.pictures import grey

Image = NDArray[np.float32]
MODEL, SPANS = "brisque_model_live.yml", "brisque_range_live.yml"
DEFINITIONS = (
    "PSNR over linear intensity with the scene's white as data range, SSIM with a Gaussian window of 1.5 pixels and "
    "population covariance over the same range; dynamic_ over the pixels that see a mover at the instant"
)


@dataclass(frozen=True)
class Scorer:
    """Every metric whose parameters are in `folder`; `omissions` says what is missing. Build with `open`."""

    lpips: Lpips | None
    brisque: Callable[[NDArray[np.uint8]], float] | None
    niqe: Niqe | None
    omissions: tuple[str, ...]

    @classmethod
    def open(cls, folder: Path | None) -> Scorer:
        """Look for AlexNet's weights and the parameters of BRISQUE and NIQE; raises BadRunError for broken ones."""
        network = sorted(folder.glob("alexnet*.pth")) if folder else []
        files = {name: folder / name for name in (MODEL, SPANS)} if folder else {}
        pristine = folder / "niqe_pris_params.npz" if folder else None
        missing = []
        if not network:
            missing.append("lpips: found no alexnet*.pth; give its folder with --metric-files")
        if not files or not all(file.exists() for file in files.values()):
            missing.append("brisque: found no brisque_model_live.yml and brisque_range_live.yml in --metric-files")
        if pristine is None or not pristine.exists():
            missing.append("niqe: found no niqe_pris_params.npz in --metric-files")
        judge = None
        if not any(line.startswith("brisque") for line in missing):
            judge = functools.partial(brisque, **{"model": files[MODEL], "spans": files[SPANS]})
        niqe = Niqe(pristine) if pristine is not None and pristine.exists() else None
        return cls(Lpips(network[0]) if network else None, judge, niqe, tuple(missing))

    def against(self, image: Image, truth: Truth) -> dict[str, float]:
        """Errors of an image in spikes per tick."""
        found = {
            "psnr_db": psnr_db(image, truth.light, truth.white),
            "ssim": ssim(image, truth.light, truth.white),
            "dynamic_psnr_db": psnr_db(image, truth.light, truth.white, truth.moves),
            "static_psnr_db": psnr_db(image, truth.light, truth.white, ~truth.moves),
            "edge_sharpness": edge_sharpness(image, truth.light, truth.moves),
        }
        if self.lpips:
            display = [(grey(a, truth.white) / np.float32(255)).astype(np.float32) for a in (image, truth.light)]
            found["lpips"] = self.lpips(*display)
        return found | self.alone(image, truth.white)

    def alone(self, image: Image, white: float) -> dict[str, float]:
        """Naturalness of the image as a person would see it."""
        pixels = grey(image, white)
        found = {}
        if self.brisque:
            found["brisque"] = self.brisque(pixels)
        if self.niqe:
            found["niqe"] = self.niqe(pixels)
        return found
