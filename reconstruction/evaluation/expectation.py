"""Scores expected errors against true ones, block by block."""

import cv2
import numpy as np
from numpy.typing import NDArray

from reconstruction.evaluation.evaluate import HeldOut
from reconstruction.native import shared_out
from reconstruction.truth import Truth, spread
from reconstruction.uncertainty.expected_error import Uncertainty

BLOCK_PX = 16  # pixels a side of a block
INSTANTS = 4  # truth instants that are compared


def block_means(image: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return the means of an image's whole blocks, [H // BLOCK_PX, W // BLOCK_PX]; one along a side that is smaller."""
    rows, columns = (max(1, length // BLOCK_PX) for length in image.shape)
    whole = image[: rows * BLOCK_PX, : columns * BLOCK_PX].astype(np.float64)
    return np.asarray(cv2.resize(whole, (columns, rows), interpolation=cv2.INTER_AREA), dtype=np.float64)


def rank_correlation(first: NDArray[np.floating], second: NDArray[np.floating]) -> float:
    """Return Spearman's rank correlation of two arrays of one shape, where equal numbers share a rank.

    It is NaN where either array is even.
    """
    if min(np.ptp(first), np.ptp(second)) == 0:
        return float("nan")
    return float(np.asarray(np.corrcoef(np.stack([_ranks(values.ravel()) for values in (first, second)])))[0, 1])


def _ranks(values: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return the ranks of values [N] from 1; those that are equal have the mean of theirs."""
    _, which, counts = np.unique(values, return_inverse=True, return_counts=True)
    return (np.cumsum(counts) - (counts - 1) / 2)[which]


def score_expectation(uncertainty: Uncertainty, held_out: HeldOut, truth: Truth) -> dict[str, float]:
    """Return how well the errors of the held-out view were expected, as means over instants of truth.

    `expected_error.rank`: the rank correlation of the expected and the true root mean square over blocks.
    `expected_error.ratio`: the expected root mean square of all pixels over the true one.
    """
    clock = held_out.recording.rig.clock

    def squares(plane: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        instant_s, wanted = clock.instant_s(plane - truth.lag_ticks), truth.frame(held_out.camera.id, plane).intensity
        seen = uncertainty.scene.look(held_out.camera, instant_s).intensity
        expected = uncertainty.look(held_out.camera, instant_s)
        return block_means(np.square(expected)), block_means(np.square(seen - wanted))

    found = list(shared_out(squares, spread(truth.planes(held_out.camera.id), INSTANTS)))
    ranks = [rank_correlation(expected, true) for expected, true in found]
    expected, true = (float(np.mean([pair[i] for pair in found])) for i in (0, 1))
    scores = {
        "expected_error.rank": float(np.mean(ranks)),
        "expected_error.ratio": (expected / max(true, 1e-30)) ** 0.5,
    }
    return {name: value for name, value in scores.items() if np.isfinite(value)}
