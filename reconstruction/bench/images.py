"""Spikes to images: planes a second against NumPy, and each method's error beside its time."""

from __future__ import annotations

import numpy as np

from acquisition.bench_document import BenchDocument, fastest_s
from acquisition.scenes.catalog import build_scene
from acquisition.scenes.source import SceneSource
from acquisition.spikes import packing
from acquisition.spikes.layout import PlaneLayout
from acquisition.spikes.sensor import Sensor
from acquisition.spikes.stream import SpikeStream
from reconstruction.images.methods import METHODS
from reconstruction.images.tfp import HALF_WINDOW
from reconstruction.metrics.image import psnr_db, ssim
from rigs.toml import catalog_rig

PLANES = 200
INSTANTS = (60, 100, 140)


def bench_images(scene_name: str, seed: int) -> BenchDocument:
    """Centre camera of the lab rig, 400x250: decoding speed, then TFI and TFP against the true instants."""
    rig = catalog_rig("lab3x3")
    camera = rig.camera("cam11")
    layout = PlaneLayout(camera.width, camera.height)
    scene = build_scene(scene_name, seed)
    sensor = Sensor(camera.width, camera.height, "real", seed, rig.ids.index("cam11"))
    packed = SceneSource(scene, camera, rig.clock, PLANES, sensor, layout, threads=0).next_planes(PLANES)
    document = BenchDocument("images")
    _decoding(document, packed, layout)
    stream = SpikeStream(packed, layout, rig.tick_rate_hz)
    truth = scene.render(camera, np.array([rig.clock.instant_s(k) for k in INSTANTS])).intensity
    for name, method in METHODS.items():
        found = [method(stream, k).intensity for k in INSTANTS]
        seconds = fastest_s(lambda method=method: method(stream, INSTANTS[1]))
        row = {
            "method": name,
            "scene": scene_name,
            "seed": seed,
            "psnr_db": float(np.mean([psnr_db(a, b, scene.white) for a, b in zip(found, truth, strict=True)])),
            "ssim": float(np.mean([ssim(a, b, scene.white) for a, b in zip(found, truth, strict=True)])),
            "seconds": seconds,
        }
        document.rows.append(row)
        document.summary[f"{name}.psnr_db"] = row["psnr_db"]
        document.summary[f"{name}.ms_per_image"] = 1e3 * seconds
    document.omissions.append("tfi has no native kernel yet: its time is NumPy's over unpacked planes")
    return document


def _decoding(document: BenchDocument, packed: np.ndarray, layout: PlaneLayout) -> None:
    """Unpacking and window means, native and in NumPy, and a plain copy of the window's bytes."""
    window = np.ascontiguousarray(packed[: 2 * HALF_WINDOW + 1])
    seconds = {
        "unpack": fastest_s(lambda: packing.unpack(packed, layout)),
        "unpack_numpy": fastest_s(lambda: packing.unpack_reference(packed, layout)),
        "unpackbits_alone": fastest_s(lambda: np.unpackbits(packed, axis=1, bitorder="little")),
        "tfp": fastest_s(lambda: packing.counts(window, layout)),
        "tfp_numpy": fastest_s(lambda: packing.counts_reference(window, layout)),
        "copy": fastest_s(window.copy),
    }
    document.rows += [{"method": name, "planes": len(packed), "seconds": s} for name, s in seconds.items()]
    document.summary |= {
        "planes_unpacked_per_s": len(packed) / seconds["unpack"],
        "unpack_x_numpy": seconds["unpack_numpy"] / seconds["unpack"],
        "unpack_x_unpackbits_alone": seconds["unpackbits_alone"] / seconds["unpack"],
        "tfp_x_numpy": seconds["tfp_numpy"] / seconds["tfp"],
        "tfp_fraction_of_copy": seconds["copy"] / seconds["tfp"],
    }
