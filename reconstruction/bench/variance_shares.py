"""Splits what SPSS sees in recorded spikes: how much the counts of windows change by motion, by counting, and by noise.

The loss compares the variance of differences of successive windows. Charges of the true light tell how much of that
variance is motion, and how much more whole spikes of an unknown phase have. The rest is the sensor's noise.
"""

import numpy as np
import torch
from numpy.typing import NDArray

from acquisition.scenes.catalog import DEVELOPMENT
from reconstruction.bench.conventions import named
from reconstruction.bench.streams import simulate_lights
from reconstruction.losses.spiking import expected_variance
from reconstruction.training.spike_variation_term import SpikeVariationTerm
from rigs.rig import Rig

Floats = NDArray[np.float64]
WINDOWS, PLANES = SpikeVariationTerm.windows, SpikeVariationTerm.planes
SCENE, SEED = DEVELOPMENT[0], 2


def variance_shares(rig: Rig) -> dict[str, float]:
    """Return what `split` finds at the centre camera of a development scene, of pixels that move and of all others."""
    clip = simulate_lights(SCENE, SEED, rig, WINDOWS * PLANES, (1.0,))
    truths = clip.truths(range(WINDOWS * PLANES))
    light = np.stack([truth.light for truth in truths], dtype=np.float64)
    moves = np.any([truth.moves for truth in truths], axis=0)
    charges = light.reshape(WINDOWS, PLANES, *moves.shape).sum(axis=1)
    starts = range(0, WINDOWS * PLANES, PLANES)
    counts = np.stack([clip.streams[1.0].counts(start, start + PLANES) for start in starts], dtype=np.float64)
    movers, still = (split(charges[:, part], counts[:, part]) for part in (moves, ~moves))
    return named("variance.movers", movers) | named("variance.still", still)


def split(charges: Floats, counts: Floats) -> dict[str, float]:
    """Return the variance of the differences of `counts` [T, N] in spikes^2, and its shares by true `charges` [T, N].

    The shares sum to one. That of noise is below zero where pixels count more evenly than by a random phase.
    """
    recorded = float(np.diff(counts, axis=0).var(axis=0).mean())
    motion = float(np.diff(charges, axis=0).var(axis=0).mean())
    counted = float(expected_variance(torch.from_numpy(charges)).mean())
    shares = {"motion": motion, "counting": counted - motion, "noise": recorded - counted}
    return {"spikes2": recorded} | {name: share / max(recorded, 1e-12) for name, share in shares.items()}
