"""TFSTP, texture from short-term plasticity: each pixel is a synapse whose state remembers its recent intervals.

At a spike, D ticks after the one before it, the resources R and the release u become
    R' = 1 - [1 - R (1 - u)] exp(-D / TAU_D)        u' = U0 + [u + F (1 - u) - U0] exp(-D / TAU_F).
Under constant light D is constant and both settle. Solving the settled equations for D inverts them:
    D = TAU_F ln [(u + F (1 - u) - U0) / (u - U0)]        D = TAU_D ln [(1 - R (1 - u)) / (1 - R)],
and the light is 1 / D: linear, in spikes per tick, with nothing to fit. u forgets a spike by the factor
(1 - F) exp(-D / TAU_F) and so averages the last few intervals; R forgets almost at once. Intervals that alternate
between D and D + 1 give their mean to 5 %, depending on which came last.
Order: TFI's sharpness with less noise, but it looks back, so movers trail a little. Cost: a dozen passes a plane.
Source: Zheng et al., "Capture the moment: high-speed imaging with spiking cameras through short-term plasticity", PAMI
2023, with its constants. Ours: time is counted in ticks, u is read where it agrees with R to `AGREE` ticks and R
elsewhere (light has just changed), and a pixel that has been silent for longer than D is that dark at most.
"""

import numpy as np
from numpy.typing import NDArray

from acquisition.spikes.stream import SpikeStream
from reconstruction.images.catalogue import Estimate, ImageMethod
from reconstruction.images.noise import interval_sigma
from reconstruction.images.replay import HISTORY, Replay

U0, TAU_D, TAU_F, F = 0.15, 1.0, 10.0, 0.15
AGREE = 1.5  # ticks: an interval's quantisation, and what u still moves


def tfstp(stream: SpikeStream, plane: int) -> Estimate:
    """Return the image at `plane` from the synapses' state at its next spike."""
    replay = Replay(stream, plane)
    spent, primed = (np.zeros(replay.silence.shape, dtype=np.float32) for _ in range(2))  # 1 - R, u - U0
    ages = np.arange(2 * HISTORY + 1, dtype=np.float32)
    refill, fade = np.exp(-ages / np.float32(TAU_D)), np.exp(-ages / np.float32(TAU_F))
    for closed, ticks in replay:
        np.copyto(spent, _drained(spent, primed) * refill[ticks], where=closed)
        np.copyto(primed, _raised(primed) * fade[ticks], where=closed)
    return _read(spent, primed, replay)


def _drained(spent: NDArray[np.float32], primed: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return 1 - R (1 - u), right after a spike."""
    u = np.add(primed, U0, dtype=np.float32)
    return spent + u - spent * u


def _raised(primed: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return u + F (1 - u) - U0, right after a spike."""
    return np.add(primed * (1 - F), F * (1 - U0), dtype=np.float32)


def _read(spent: NDArray[np.float32], primed: NDArray[np.float32], replay: Replay) -> Estimate:
    """Return 1 / D of the settled equations."""
    valid = replay.intervals > 0
    one = np.ones_like(spent)
    by_u = TAU_F * np.log(np.divide(_raised(primed), primed, out=one.copy(), where=valid))
    by_r = TAU_D * np.log(np.divide(_drained(spent, primed), spent, out=one.copy(), where=valid))
    ticks = np.where(np.abs(by_u - by_r) <= AGREE, by_u, by_r)
    ticks = np.where(valid, np.maximum(ticks, replay.silence), replay.longest + 1)
    ticks = np.maximum(ticks, 1).astype(np.float32)
    return Estimate(np.reciprocal(ticks), valid & ~replay.saturated, interval_sigma(np.floor(ticks).astype(np.int32)))


METHOD = ImageMethod("tfstp", tfstp, price_s=0.13)
