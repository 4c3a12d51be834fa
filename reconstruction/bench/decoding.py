"""Times packed planes becoming images, beside the NumPy recipes of the public tools and a copy of the bytes.

The recipes unpack every plane of the recording once and then work on arrays of a byte a pixel. TFP is the mean of the
planes around the instant. TFI walks over planes, back and ahead from the instant, and counts the silent ones until all
pixels have fired or the reach is over. Both give the same images as ours, which a test checks; ours are timed on one
core too, and as the recipes for the intensity alone, without validity and sigma.
"""

import os
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from acquisition.bench_document import BenchDocument, fastest_s
from acquisition.spikes import packing
from acquisition.spikes.packing import unpack_reference
from acquisition.spikes.stream import SpikeStream
from reconstruction.images.methods.tfi import REACH, tfi_images, tfi_intensities
from reconstruction.images.methods.tfp import HALF_WINDOW, tfp_intensities

IMAGES, CAMERAS = 20, 9


def tfp_recipe(stream: SpikeStream, planes: Sequence[int]) -> list[NDArray]:
    """Return images [H, W] as the public tools make them: unpack all, then take the mean over the window."""
    spikes = unpack_reference(stream.packed, stream.layout)
    return [spikes[max(0, k - HALF_WINDOW) : k + HALF_WINDOW + 1].mean(axis=0) for k in planes]


def tfi_recipe(stream: SpikeStream, planes: Sequence[int]) -> list[NDArray]:
    """Return images [H, W] as the public tools make them: unpack all, then walk plane by plane from the instant."""
    spikes = unpack_reference(stream.packed, stream.layout).astype(bool)
    images = []
    for plane in planes:
        back = _walk(spikes[max(0, plane - REACH) : plane + 1][::-1])
        ahead = _walk(spikes[plane + 1 : plane + REACH + 1])
        images.append(1 / (back + ahead + 1))
    return images


def _walk(spikes: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return the number of silent planes [H, W] before each pixel's first spike."""
    silent, waiting = np.zeros(spikes.shape[1:], dtype=np.int64), np.ones(spikes.shape[1:], dtype=bool)
    for plane in spikes:
        waiting &= ~plane
        silent += waiting
        if not waiting.any():
            break
    return silent


def bench_decoding(document: BenchDocument, stream: SpikeStream) -> None:
    """Time unpacking, TFP and TFI of one recording, in seconds and as ratios; a rig of nine takes every core."""
    instants = list(np.linspace(10, len(stream) - 10, IMAGES).astype(int))
    window = np.ascontiguousarray(stream.packed[: 2 * HALF_WINDOW + 1])
    packed, layout = stream.packed, stream.layout
    threads = len(os.sched_getaffinity(0))
    seconds = {
        "unpack": fastest_s(lambda: packing.unpack(packed, layout)),
        "unpack_numpy": fastest_s(lambda: unpack_reference(packed, layout), 3),
        "unpackbits_alone": fastest_s(lambda: np.unpackbits(packed, axis=1, bitorder="little"), 3),
        "tfp_window": fastest_s(lambda: packing.counts(window, layout), 50),
        "copy_window": fastest_s(window.copy, 50),
        "tfp_images": fastest_s(lambda: tfp_intensities(stream, instants)),
        "tfp_images_numpy": fastest_s(lambda: tfp_recipe(stream, instants), 2),
        "tfi_images": fastest_s(lambda: tfi_intensities(stream, instants)),
        "tfi_images_numpy": fastest_s(lambda: tfi_recipe(stream, instants), 2),
        "tfi_rig": fastest_s(lambda: [tfi_images(stream, instants, threads=threads) for _ in range(CAMERAS)], 3),
    }
    for name, taken in seconds.items():
        document.rows.append({"part": "decoding", "method": name, "planes": len(packed), "seconds": taken})
    document.summary |= {
        "planes_unpacked_per_s": len(packed) / seconds["unpack"],
        "unpack_x_numpy": seconds["unpack_numpy"] / seconds["unpack"],
        "unpack_x_unpackbits_alone": seconds["unpackbits_alone"] / seconds["unpack"],
        "tfp_x_numpy": seconds["tfp_images_numpy"] / seconds["tfp_images"],
        "tfi_x_numpy": seconds["tfi_images_numpy"] / seconds["tfi_images"],
        "tfp_fraction_of_copy": seconds["copy_window"] / seconds["tfp_window"],
        "tfi_9x20_images_s": seconds["tfi_rig"],
        "tfp.planes_per_s": len(window) / seconds["tfp_window"],
        "tfp.gb_per_s": 1e-9 * window.nbytes / seconds["tfp_window"],
        "tfi.planes_per_s": len(packed) / seconds["tfi_images"],
        "tfi.gb_per_s": 1e-9 * packed.nbytes / seconds["tfi_images"],
    }
