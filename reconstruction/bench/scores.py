"""Scores single images for the image bench: errors against the truth, and naturalness without one.

One of the published recordings has a truth picture. Its grey values are linear: the slope image times one factor
(1 / 0.6, by least squares) meets it to 36 dB as it is, and to 22 dB if it is taken for gamma 2.2. So PSNR and SSIM are
of the image times that factor, fitted for each image, against the grey values over 255, with data range 1.
"""

import os
from collections.abc import Callable
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from acquisition.arrays import read_arrays
from acquisition.spikes.layout import PlaneLayout
from acquisition.spikes.packing import pack
from acquisition.spikes.stream import SpikeStream
from reconstruction.bench.conventions import RATE_HZ
from reconstruction.bench.streams import TrueImage
from reconstruction.metrics.image import edge_sharpness, psnr_db, ssim_map
from reconstruction.metrics.lpips import Lpips
from reconstruction.metrics.natural import Niqe, brisque
from reconstruction.report.display import grey

Image = NDArray[np.float32]
VIDAR = PlaneLayout(400, 250)
CAR, DIM, SYNTHETIC = "histsflow_car.dat", "zoo_uhsr.npz", "zoo_data_200_part1.dat"
TRUTH = "zoo_data_200_part1_gt.png"
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
            "ssim": float(ssim_map(image, truth.light, truth.white).mean()),
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


def spikedata_folder() -> Path:
    """Return the folder of recordings that are not in the repository."""
    return Path(os.environ.get("SPIKE4DGS_SHARED", Path(__file__).parents[3] / "shared")) / "spikedata"


def open_recording(path: Path) -> SpikeStream:
    """Open a Vidar `.dat`, or an `.npz` whose `spk` [T, H, W] is upright.

    The files do not tell their plane rate; RATE_HZ is assumed, and no score depends on it.
    """
    if path.suffix != ".npz":
        return SpikeStream.open(path, VIDAR, RATE_HZ)
    planes = read_arrays(path)["spk"]
    layout = PlaneLayout(planes.shape[2], planes.shape[1])
    return SpikeStream(pack(planes, layout), layout, RATE_HZ)


def real_recordings() -> tuple[dict[str, SpikeStream], list[str]]:
    """Return the recordings that are not in the repository by the names of their files, and a line for each missing."""
    paths = [spikedata_folder() / name for name in (CAR, DIM, SYNTHETIC)]
    missing = [f"{path.name}: not found in $SPIKE4DGS_SHARED/spikedata" for path in paths if not path.exists()]
    return {path.stem: open_recording(path) for path in paths if path.exists()}, missing


def score_recording(scorer: Scorer, image: Image, truth: Path | None) -> dict[str, float]:
    """Return the naturalness of an image [H, W], white being its 99.9th percentile, and its errors against `truth`."""
    found = scorer.alone(image, float(np.percentile(image, 99.9)))
    if truth is None:
        return found
    wanted = np.asarray(cv2.imread(str(truth), cv2.IMREAD_GRAYSCALE), dtype=np.float32) / np.float32(255)
    gain = float((image * wanted).sum() / max(float(np.square(image).sum()), 1e-12))
    fitted = (image * np.float32(gain)).astype(np.float32)
    alike = float(ssim_map(fitted, wanted, 1.0).mean())
    return found | {"gain": gain, "psnr_db": psnr_db(fitted, wanted, 1.0), "ssim": alike}
