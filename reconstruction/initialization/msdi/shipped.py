"""The weights of MSDI that ship with the package, or one's own."""

from __future__ import annotations

import functools
from pathlib import Path

from reconstruction.images.learned.weights import read_weights
from reconstruction.initialization.msdi.network import Msdi, small_msdi

SHIPPED = Path(__file__).parent / "weights"


@functools.cache
def trained(weights: Path | None = None) -> Msdi:
    """The small tier with `weights`, by default those that ship; raises BadRunError where they do not fit."""
    module = small_msdi().eval()
    read_weights(weights or SHIPPED / "small.npz", module)
    return module
