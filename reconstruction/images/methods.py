"""The spike-to-image methods by the name an operator gives."""

from collections.abc import Callable

from acquisition.spikes.stream import SpikeStream
from reconstruction.errors import BadRunError
from reconstruction.images.estimate import Estimate
from reconstruction.images.tfi import tfi
from reconstruction.images.tfp import tfp

Method = Callable[[SpikeStream, int], Estimate]
METHODS: dict[str, Method] = {"tfi": tfi, "tfp": tfp}


def method(name: str) -> Method:
    """The method called `name`; raises BadRunError listing the known ones."""
    if name not in METHODS:
        raise BadRunError(f"found the image method {name!r}, expected one of {', '.join(METHODS)}")
    return METHODS[name]
