"""Defines cases of the mean of a training's last steps: long ones, and numbers of any size, against float64."""

import torch

from reconstruction.stability.case import Case, Observation
from reconstruction.training.averaging import EVERY, SHARE, Averages

STEPS = 40_000
SIZES = (1e-30, 1e-6, 1.0, 1e6, 1e30)  # of five tensors that are seen at once


def _long_mean(_: str) -> Observation:
    """Compare the mean of noisy steps with its definition; the error is in deviations of the noise."""
    draws = torch.randn(STEPS // EVERY, len(SIZES), 8, generator=torch.Generator().manual_seed(0))
    sizes, averages = torch.tensor(SIZES), Averages()
    for step in range(STEPS):
        looks = 3 + draws[step // EVERY]
        averages.see([(str(i), (size * looks[i]).requires_grad_()) for i, size in enumerate(sizes)], 0.0)
    exact = 3 + draws[0].double()
    for number, draw in enumerate(draws[1:], start=2):
        exact += min(1.0, 1 / (SHARE * number)) * (3 + draw.double() - exact)
    found = torch.stack([averages.means[str(i)].double() / size for i, size in enumerate(sizes.double())])
    error = float((found - exact).abs().max())
    return Observation(f"{STEPS:,} steps, sizes 1e-30 to 1e30: {error:.1e} of the noise apart", error)


CASES = (Case(None, "mean of the last steps", "float64's mean at any size", 1e-5, _long_mean),)
