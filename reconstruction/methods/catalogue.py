"""Every method by the name an operator gives."""

from reconstruction.methods.four_dgs import FOUR_DGS
from reconstruction.methods.method import Method
from reconstruction.methods.ours import BASES, CUBIC, LINEAR, STATIC
from reconstruction.methods.spikenerf import DY_SPIKENERF, SPIKENERF

METHODS: dict[str, Method] = {m.name: m for m in (STATIC, LINEAR, CUBIC, BASES, FOUR_DGS, SPIKENERF, DY_SPIKENERF)}
