"""`.spz`: a gzip stream of columns, a tenth of the size of `ply`. Version 3, degree 0.

Header of 16 bytes, then positions (24-bit fixed point), opacities (8 bits), colours (8 bits over 0.5 +- 0.5 / 0.15
coefficients of degree 0), scales (8 bits, 16 a unit of the log from -10 on) and quaternions (the three smallest of
x, y, z, w: sign and 9 bits each, the largest one's index in the top two bits). Axes are RUB: x right, y up, z backward.
Grey is that of `ply`. The flag says antialiased, as this renderer is. As many bits of a position are fractional as the
scene's extent leaves, so its step is under a millionth of the extent.
Written here because the format's own library is not on the package index and what is there needs a Rust or a JIT
compiler. Source: Niantic, nianticlabs/spz, README and `load-spz.cc`.
"""

from __future__ import annotations

import gzip
import math
import struct

import numpy as np
from numpy.typing import NDArray

from reconstruction.export.scene import SH_0, Floats, Splats, up_and_back

MAGIC, VERSION, ANTIALIASED = 0x5053474E, 3, 1
COLOUR_SCALE = 0.15
MOST_FRACTIONAL_BITS = 20  # a micrometre; beyond it nothing is gained
HALF_SQRT_2 = math.sqrt(0.5)  # the most that any but the largest component of a unit quaternion can be


def spz_bytes(splats: Splats) -> bytes:
    """The file's bytes; the same Gaussians give the same bytes."""
    splats = up_and_back(splats)
    reach = float(np.abs(splats.means).max(initial=1e-6))
    bits = int(np.clip(22 - math.ceil(math.log2(reach)), 0, MOST_FRACTIONAL_BITS))
    header = struct.pack("<IIIBBBB", MAGIC, VERSION, len(splats), 0, bits, ANTIALIASED, 0)
    coefficients = (splats.display() - 0.5) / SH_0
    columns = (
        _fixed_point(splats.means, bits),
        _bytes(255 * splats.opacities),
        np.repeat(_bytes(255 * (COLOUR_SCALE * coefficients + 0.5))[:, None], 3, axis=1),
        _bytes(16 * (np.log(splats.scales) + 10)),
        _smallest_three(splats.quats_wxyz),
    )
    return gzip.compress(header + b"".join(column.tobytes() for column in columns), mtime=0)


def _fixed_point(means: Floats, bits: int) -> NDArray[np.uint8]:
    """Positions [N, 3] as the three low bytes [N, 3, 3] of little-endian integers."""
    whole = np.clip(np.round(means.astype(np.float64) * 2**bits), -(2**23), 2**23 - 1).astype("<i4")
    return np.ascontiguousarray(whole[..., None].view(np.uint8)[..., :3])


def _smallest_three(quats_wxyz: Floats) -> NDArray[np.uint32]:
    """Unit quaternions [N, 4] as one little-endian integer [N] each."""
    quats = np.roll(quats_wxyz, -1, axis=1)  # x, y, z, w
    largest = np.abs(quats).argmax(axis=1)
    rows = np.arange(len(quats))
    quats = quats * np.where(quats[rows, largest] < 0, -1, 1)[:, None]
    packed = largest.astype(np.uint32)
    for axis in range(4):
        size = np.minimum(np.abs(quats[:, axis]) / HALF_SQRT_2 * 511 + 0.5, 511).astype(np.uint32)
        field = ((quats[:, axis] < 0).astype(np.uint32) << 9) | size
        packed = np.where(axis == largest, packed, (packed << 10) | field)
    return packed.astype("<u4")


def _bytes(values: Floats) -> NDArray[np.uint8]:
    return np.clip(np.round(values), 0, 255).astype(np.uint8)
