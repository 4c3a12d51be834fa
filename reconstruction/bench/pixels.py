"""Measures the worth of calibrated pixels: the error of a still picture before and after the correction."""

import time
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from acquisition.bench_document import BenchDocument
from acquisition.scenes.calibration import FLAT_LEVEL
from acquisition.scenes.catalog import build_scene
from acquisition.spikes.layout import PlaneLayout
from acquisition.spikes.packing import pack
from acquisition.spikes.sensor import Sensor
from acquisition.spikes.stream import SpikeStream
from reconstruction.bench.conventions import HOLDOUT, means
from reconstruction.images.pixels import estimate_pixels
from reconstruction.metrics.image import psnr_db
from rigs.toml import catalog_rig

FLAT_PLANES = DARK_PLANES = 4000
PICTURE_PLANES = 2000
CHUNK = 100  # planes made at a time


def bench_pixels(scene_name: str, seeds: Sequence[int]) -> BenchDocument:
    """Let the centre camera of the lab rig, 400x250, look at a still scene, at even light and at none.

    `before_db` is the plain mean of the planes, `defects_mended_db` the same with true values at hot and dead pixels,
    `after_db` with the calibration.
    """
    document = BenchDocument("pixels", [_row(scene_name, seed) for seed in seeds])
    document.summary = means(document.rows, ("before_db", "defects_mended_db", "after_db"))
    document.summary["gain_db"] = document.summary["after_db"] - document.summary["before_db"]
    return document


def _row(scene_name: str, seed: int) -> dict:
    rig = catalog_rig("lab3x3")
    camera = rig.camera(HOLDOUT)
    scene = build_scene(scene_name, seed)
    truth = scene.render(camera, np.zeros(1)).intensity[0]

    def exposed(light: NDArray[np.float32] | float, planes: int) -> SpikeStream:
        sensor = Sensor(camera.width, camera.height, "real", seed, rig.ids.index(HOLDOUT), threads=0)
        layout = PlaneLayout(camera.width, camera.height)
        image = np.broadcast_to(np.asarray(light, np.float32), (CHUNK, camera.height, camera.width))
        packed = [pack(sensor.expose(image), layout) for _ in range(planes // CHUNK)]
        return SpikeStream(np.concatenate(packed), layout, rig.tick_rate_hz)

    flat, dark = exposed(FLAT_LEVEL, FLAT_PLANES), exposed(0.0, DARK_PLANES)
    started = time.perf_counter()
    calibration = estimate_pixels(flat, dark)
    seconds = time.perf_counter() - started
    image = (exposed(truth, PICTURE_PLANES).counts(0, PICTURE_PLANES) / PICTURE_PLANES).astype(np.float32)
    return {
        "method": "pixels",
        "scene": scene_name,
        "seed": seed,
        "hot": int(calibration.hot.sum()),
        "dead": int(calibration.dead.sum()),
        "before_db": float(psnr_db(image, truth, scene.white)),
        "defects_mended_db": float(psnr_db(np.where(calibration.defect, truth, image), truth, scene.white)),
        "after_db": float(psnr_db(calibration.corrected(image), truth, scene.white)),
        "seconds": seconds,
    }
