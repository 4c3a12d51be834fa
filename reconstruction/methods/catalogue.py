"""Every method by the name an operator gives."""

from reconstruction.methods.d3dgs import D3DGS
from reconstruction.methods.definition import Method
from reconstruction.methods.four_dgs import FOUR_DGS
from reconstruction.methods.ours import BASES, CUBIC, LINEAR, STATIC
from reconstruction.methods.spikegs import DY_SPIKEGS, SPIKEGS
from reconstruction.methods.spikenerf import DY_SPIKENERF, SPIKENERF
from reconstruction.methods.stg import STG

OURS = (STATIC, LINEAR, CUBIC, BASES)
BASELINES = (FOUR_DGS, STG, D3DGS, SPIKEGS, DY_SPIKEGS, SPIKENERF, DY_SPIKENERF)
METHODS: dict[str, Method] = {m.name: m for m in (*OURS, *BASELINES)}
