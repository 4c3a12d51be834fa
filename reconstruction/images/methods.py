"""The spike-to-image methods by the name an operator gives."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from acquisition.spikes.layout import PlaneLayout
from acquisition.spikes.packing import pack
from acquisition.spikes.stream import SpikeStream
from reconstruction.errors import BadRunError
from reconstruction.images.adaptive import adaptive
from reconstruction.images.blindspot import blindspot
from reconstruction.images.estimate import Estimate
from reconstruction.images.interpolated import interpolated
from reconstruction.images.slope import slope
from reconstruction.images.spk2imgnet import spk2imgnet
from reconstruction.images.tfi import tfi
from reconstruction.images.tfp import tfp
from reconstruction.images.tfstp import tfstp
from reconstruction.images.tvs import tvs

Method = Callable[[SpikeStream, int], Estimate]
FOCUSED = {"interpolated": interpolated}  # can look at some pixels only
LEARNED = {"spk2imgnet": spk2imgnet, "blindspot": blindspot}
METHODS: dict[str, Method] = {
    "tfi": tfi,
    "tfp": tfp,
    "tfstp": tfstp,
    "tvs": tvs,
    "slope": slope,
    "adaptive": adaptive,
    **FOCUSED,
    **LEARNED,
}


def method_for(name: str, layout: PlaneLayout, pixels: NDArray[np.bool_]) -> Method:
    """`method(name)` for a caller who uses nothing but `pixels` [H, W]: quicker where a method can look there only."""
    if name not in FOCUSED:
        return method(name)
    return partial(FOCUSED[name], wanted=pack(pixels[None], layout)[0])


def method(name: str, weights: Path | None = None) -> Method:
    """The method called `name`, a learned one with `weights` if given; raises BadRunError listing the known ones."""
    if name not in METHODS:
        raise BadRunError(f"found the image method {name!r}", f"one of {', '.join(METHODS)}")
    if weights is None:
        return METHODS[name]
    if name not in LEARNED:
        raise BadRunError(f"found weights for the method {name!r}", f"one of {', '.join(LEARNED)} beside them")
    return partial(LEARNED[name], weights=weights)
