"""Defines cases of the limits that training keeps, and of the pixels that still points are drawn from, at any size."""

from itertools import product

import numpy as np
import torch

from reconstruction.initialization.texture import PIXELS_EACH, PLAIN_SHARE, thinned
from reconstruction.stability.case import Case, Observation
from reconstruction.training.limits import WIDEST, keep_sizes

SIZES_M = (0.0, 1e-30, 1e-3, 1.0, 1e6, 1e30, float("inf"))
AWAY_M = (1e-6, 1e-3, 1.0, 1e6, 1e18)
TOLERANCE = 1e-5  # relative, of the logarithm's exponential in float32
SHAPE, VIEWS = (40, 50), 8


def _sizes(_: str) -> Observation:
    """Cut every size at every distance, and compare the outcome with its definition in float64."""
    sizes, away = (torch.tensor(values, dtype=torch.float64) for values in (SIZES_M, AWAY_M))
    grid, far = sizes.repeat(len(away)), away.repeat_interleave(len(sizes))
    means = torch.stack([far, 0 * far, 0 * far], dim=1).float()
    log_scales = grid.log().float()[:, None].repeat(1, 3)
    keep_sizes([("still.means", means), ("still.log_scales", log_scales)], torch.zeros(3), 1e-6)
    found, exact = log_scales.double().exp(), torch.minimum(grid, WIDEST * far)[:, None]
    error = float(((found - exact).abs() / exact.clamp(min=1e-30)).max())
    return Observation(f"{len(grid)} sizes, 0 to infinity, at 1e-6 to 1e18 m: {error:.1e} apart", error)


def _plain(_: str) -> Observation:
    """Thin out scenes from plain to textured, from one pixel on; the error is in points and pixels too many or few."""
    rng, errors = np.random.default_rng(0), [0.0]
    for share, wanted, most in product((0.0, 1 / 2000, 0.16, 1.0), (0.0, 1 / 2000, 1.0), (0, 1, 200, 10**9)):
        sure, masks = (np.stack([rng.random(SHAPE) < p for _ in range(VIEWS)]) for p in (share, wanted))
        kept, count = thinned([*masks], [*sure], most, rng)
        left, strange = np.sum(kept), (np.stack(kept) & ~masks) | (masks & sure & ~np.stack(kept))
        exact = min(most, max(left / VIEWS / PIXELS_EACH, most * left / max(masks.sum(), 1)))
        errors += [abs(count - exact) - 0.5, count - most, np.sum(strange)]
    return Observation(f"no pixel to all, one in {1 / PLAIN_SHARE:g} of the plain ones", float(max(errors)))


CASES = (
    Case(None, "Gaussians stretched without end", "three tenths of their distance, finite", TOLERANCE, _sizes),
    Case(None, "points of plain scenes", "no fewer on texture, none unasked for", 1e-9, _plain),
)
