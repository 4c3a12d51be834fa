"""`.spz`: a gzip stream of columns, a tenth of the size of `ply`. Version 3, degree 0.

Header of 16 bytes, then positions (24-bit fixed point), opacities (8 bits), colours (8 bits over 0.5 +- 0.5 / 0.15
coefficients of degree 0), scales (8 bits, 16 a unit of the log from -10 on) and quaternions (the three smallest of
x, y, z, w: sign and 9 bits each, the largest one's index in the top two bits). Axes are RUB: x right, y up, z backward.
Grey is that of `ply`. The flag says antialiased, as this renderer is. A position has as many fractional bits as the
scene's extent leaves, so its step is under a millionth of the extent.
The format's own library is not on the package index, and the ones there need a Rust or a JIT compiler. Source:
Niantic, nianticlabs/spz, README and `load-spz.cc`.
"""

import gzip
import math
import struct

import numpy as np
from numpy.typing import NDArray

from reconstruction.export.splats import SH_0, Floats, Splats, splat_format, to_bytes

MAGIC, VERSION, ANTIALIASED = 0x5053474E, 3, 1
COLOUR_SCALE = 0.15
MOST_FRACTIONAL_BITS = 20  # of a position in m: a micrometre
HALF_SQRT_2 = math.sqrt(0.5)  # largest size of any but the largest component of a unit quaternion


def spz_bytes(splats: Splats) -> bytes:
    """Return the bytes of a file of Gaussians at one instant; the same Gaussians give the same bytes."""
    splats = splats.up_and_back()
    reach = float(np.abs(splats.means).max(initial=1e-6))
    bits = int(np.clip(22 - math.ceil(math.log2(reach)), 0, MOST_FRACTIONAL_BITS))
    header = struct.pack("<IIIBBBB", MAGIC, VERSION, len(splats), 0, bits, ANTIALIASED, 0)
    coefficients = (splats.display() - 0.5) / SH_0
    columns = (
        _fixed_point(splats.means, bits),
        to_bytes(255 * splats.opacities),
        np.repeat(to_bytes(255 * (COLOUR_SCALE * coefficients + 0.5))[:, None], 3, axis=1),
        to_bytes(16 * (np.log(splats.scales) + 10)),
        _smallest_three(splats.quats_wxyz),
    )
    return gzip.compress(header + b"".join(column.tobytes() for column in columns), mtime=0)


def _fixed_point(means: Floats, bits: int) -> NDArray[np.uint8]:
    """Return positions [N, 3] in m as the three low bytes [N, 3, 3] of integers, `bits` of them fractional."""
    whole = np.clip(np.round(means.astype(np.float64) * 2**bits), -(2**23), 2**23 - 1).astype("<i4")
    return np.ascontiguousarray(whole[..., None].view(np.uint8)[..., :3])


def _smallest_three(quats_wxyz: Floats) -> NDArray[np.uint32]:
    """Return unit quaternions [N, 4] as one little-endian integer [N] each."""
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


SPZ = splat_format("spz", "the Gaussians at one instant in 17 bytes each or less, y up", spz_bytes)
