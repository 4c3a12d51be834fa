"""Scores single images for the image bench: errors against the truth, and naturalness without one."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
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
MODEL, SPANS, PRISTINE = "brisque_model_live.yml", "brisque_range_live.yml", "niqe_pris_params.npz"
DEFINITIONS = (
    "PSNR over linear intensity with the scene's white as data range, SSIM with a Gaussian window of 1.5 pixels and "
    "population covariance over the same range; dynamic_ over the pixels that see a mover at the instant"
)


@dataclass(frozen=True)
class Scorer:
    """The metrics whose parameters were found; `omissions` names the others. Build with `open`."""

    lpips: Lpips | None
    brisque: Callable[[NDArray[np.uint8]], float] | None
    niqe: Niqe | None
    omissions: tuple[str, ...]

    @classmethod
    def open(cls, folder: Path | None) -> Scorer:
        """Find AlexNet's weights and the parameters of BRISQUE and NIQE; raises BadRunError for broken ones."""
        network = sorted(folder.glob("alexnet*.pth")) if folder else []
        model, spans, pristine = ((folder or Path()) / name for name in (MODEL, SPANS, PRISTINE))
        judged = bool(folder) and model.exists() and spans.exists()
        known = bool(folder) and pristine.exists()
        found = {
            "lpips": (network, "alexnet*.pth"),
            "brisque": (judged, f"{MODEL} and {SPANS}"),
            "niqe": (known, PRISTINE),
        }
        return cls(
            Lpips(network[0]) if network else None,
            functools.partial(brisque, model=model, spans=spans) if judged else None,
            Niqe(pristine) if known else None,
            tuple(f"{name}: found no {files} in --metric-files" for name, (there, files) in found.items() if not there),
        )

    def against(self, image: Image, truth: TrueImage) -> dict[str, float]:
        """Return the errors of an image [H, W] in spikes per tick, and its naturalness."""
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
        """Return the naturalness of an image [H, W] as a person would see it; `white` is shown as white."""
        pixels = grey(image, white)
        found = {}
        if self.brisque:
            found["brisque"] = self.brisque(pixels)
        if self.niqe:
            found["niqe"] = self.niqe(pixels)
        return found
