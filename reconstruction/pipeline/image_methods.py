"""Every spike-to-image method by name: the single-camera ones, and MSDI's image network, part of an initialiser."""

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from acquisition.spikes.layout import PlaneLayout
from acquisition.spikes.stream import SpikeStream
from reconstruction.images import methods
from reconstruction.images.estimate import Estimate
from reconstruction.images.methods import METHODS, Method

MSDI = "msdi"


def _msdi(stream: SpikeStream, plane: int, weights: Path | None = None) -> Estimate:
    from reconstruction.initialization.msdi.image import msdi  # torch, which most methods do without

    return msdi(stream, plane, weights)


ALL_METHODS: Mapping[str, Method] = MappingProxyType({**METHODS, MSDI: _msdi})


def image_method(name: str, weights: Path | None = None) -> Method:
    """The method called `name`, a learned one with `weights` if given; raises BadRunError listing the known ones."""
    if name != MSDI:
        return methods.method(name, weights)
    return lambda stream, plane: _msdi(stream, plane, weights)


def image_method_for(name: str, layout: PlaneLayout, pixels: NDArray[np.bool_]) -> Method:
    """`image_method(name)` for a caller who uses nothing but `pixels` [H, W]."""
    return _msdi if name == MSDI else methods.method_for(name, layout, pixels)
