"""Draws the cells of a view's picture that a step compares: more often where they are wrong.

A cell of error e is drawn with a probability p that grows with e, and weighs 1 / p, so that the expected gradient is
that of the whole picture. Letters: c rows of d cells; see `losses.picture`.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from reconstruction.losses.picture import CELL_PX, cells_of
from reconstruction.losses.ssim import REACH_PX
from reconstruction.rendering.render import BLOCK_PX, blocks_of
from rigs.camera import Camera

LEAST = 0.1  # least probability of a cell
MEMORY = 4  # looks at a cell in the mean of its error


@dataclass(frozen=True, eq=False)
class Drawn:
    """The cells of a step: their `weights` [c, d], 0 where not drawn, and the blocks that must be `wanted` for them."""

    weights: Tensor
    wanted: Tensor


class CellDraws:
    """The errors [c, d] of the cells of one view, and draws by them; `share` of the picture is drawn on average."""

    def __init__(self, camera: Camera, share: float) -> None:
        self.camera, self.share = camera, share
        self.errors = np.full(cells_of(camera.height, camera.width), np.nan)

    def draw(self, rng: np.random.Generator) -> Drawn | None:
        """Draw cells; None stands for the whole picture, which is drawn until every cell was looked at once."""
        if self.share >= 1 or np.isnan(self.errors).any():
            return None
        chance = chances(self.errors, self.share)
        drawn = rng.random(chance.shape) < chance
        if not drawn.any():
            drawn.flat[rng.choice(drawn.size, p=(chance / chance.sum()).ravel())] = True
        weights = np.where(drawn, 1 / chance, 0).astype(np.float32)
        return Drawn(torch.from_numpy(weights), torch.from_numpy(self._wanted(drawn)))

    def _wanted(self, drawn: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return the blocks of the drawn cells and of what their windows reach."""
        side, reach = CELL_PX // BLOCK_PX, -(-REACH_PX // BLOCK_PX)
        down, across = blocks_of(self.camera)
        blocks = drawn.repeat(side, 0).repeat(side, 1)[:down, :across].astype(np.uint8)
        return cv2.dilate(blocks, np.ones((2 * reach + 1,) * 2, np.uint8)).astype(bool)

    def see(self, drawn: Drawn | None, errors: Tensor) -> None:
        """Take in the errors [c, d] of the cells that were drawn."""
        seen = np.ones(self.errors.shape, bool) if drawn is None else drawn.weights.numpy() > 0
        new = errors.numpy()
        mean = np.where(np.isnan(self.errors), new, self.errors + (new - self.errors) / MEMORY)
        self.errors = np.where(seen, mean, self.errors)


def chances(errors: NDArray[np.float64], share: float) -> NDArray[np.float64]:
    """Return probabilities [c, d] in proportion to errors, but from LEAST to 1, with the mean `share`."""
    errors = np.maximum(errors, 1e-12)
    low, high = 0.0, 1 / errors.min()
    for _ in range(40):
        middle = (low + high) / 2
        if np.clip(middle * errors, LEAST, 1).mean() < share:
            low = middle
        else:
            high = middle
    return np.clip(high * errors, LEAST, 1)
