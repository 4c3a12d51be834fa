"""Reads and scores published recordings for the image bench, where their files are at hand.

The synthetic recording has a truth picture. Its grey values are linear: the slope image times one factor (1 / 0.6, by
least squares) meets it to 36 dB as it is, and to 22 dB if it is taken for gamma 2.2. So PSNR and SSIM are of the image
times that factor, fitted for each image, against the grey values over 255, with data range 1.
"""

import os
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from acquisition.spikes.layout import PlaneLayout
from acquisition.spikes.packing import pack
from acquisition.spikes.stream import SpikeStream
from reconstruction.bench.conventions import RATE_HZ
from reconstruction.bench.scores import Scorer
from reconstruction.metrics.image import psnr_db, ssim

VIDAR = PlaneLayout(400, 250)
CAR, DIM, SYNTHETIC = "histsflow_car.dat", "zoo_uhsr.npz", "zoo_data_200_part1.dat"
TRUTH = "zoo_data_200_part1_gt.png"


def spikedata_folder() -> Path:
    """Return the folder of recordings that are not in the repository."""
    return Path(os.environ.get("SPIKE4DGS_SHARED", Path(__file__).parents[3] / "shared")) / "spikedata"


def open_recording(path: Path) -> SpikeStream:
    """Open a Vidar `.dat`, or an `.npz` whose `spk` [T, H, W] is upright.

    The files do not tell their plane rate; RATE_HZ is assumed, and no score depends on it.
    """
    if path.suffix != ".npz":
        return SpikeStream.open(path, VIDAR, RATE_HZ)
    with np.load(path, allow_pickle=False) as stored:
        planes = stored["spk"]
    layout = PlaneLayout(planes.shape[2], planes.shape[1])
    return SpikeStream(pack(planes, layout), layout, RATE_HZ)


def score_recording(scorer: Scorer, image: NDArray[np.float32], truth: Path | None) -> dict[str, float]:
    """Return the naturalness of an image [H, W], white being its 99.9th percentile, and its errors against `truth`."""
    found = scorer.alone(image, float(np.percentile(image, 99.9)))
    if truth is None:
        return found
    wanted = np.asarray(cv2.imread(str(truth), cv2.IMREAD_GRAYSCALE), dtype=np.float32) / np.float32(255)
    gain = float((image * wanted).sum() / max(float(np.square(image).sum()), 1e-12))
    fitted = (image * np.float32(gain)).astype(np.float32)
    return found | {"gain": gain, "psnr_db": psnr_db(fitted, wanted, 1.0), "ssim": ssim(fitted, wanted, 1.0)}
