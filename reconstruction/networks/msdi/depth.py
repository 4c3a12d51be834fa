"""Inverse depth by plane sweep over learnt features, with its confidence.

Correlation volumes of feature groups (Guo et al., "Group-wise correlation stereo network", CVPR 2019) over the other
views, mean and best, cleaned by a small 3D network; the inverse depth is the mean of the likeliest steps; brought to
the working size by learnt convex combinations (Teed and Deng, "RAFT", ECCV 2020). Confidence is DUSt3R's (Wang et al.,
CVPR 2024), 1 + exp. Letters: V views, K inverse depths, h = H / 4, w = W / 4, G groups.
"""

from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from reconstruction.networks.msdi.encoder import MIDDLE_WIDTH
from reconstruction.networks.msdi.views import LEAST_Z, Views, inverse_depths

CELL = 4  # px of the working size
STEPS, GROUPS, WIDTH = 48, 4, 32  # width: channels that are compared
CLEANING = 8  # channels of the 3D network
AROUND = 2  # steps to either side of the likeliest that the mean is taken over
MOST_SOURCES = 4
NO_DOUBT = 4.0  # logarithm of the largest confidence


class Swept(NamedTuple):
    """Of one view: `logits` [K, h, w] of the steps, `inverse_depth` [H, W] in 1/m and `confidence` [H, W] above 1."""

    logits: Tensor
    inverse_depth: Tensor
    confidence: Tensor


class Sweep(nn.Module):
    """Depth of one view at a time, from the features of all."""

    def __init__(self) -> None:
        super().__init__()
        self.compare = nn.Conv2d(MIDDLE_WIDTH, WIDTH, 1)
        self.clean = nn.Sequential(
            nn.Conv3d(2 * GROUPS, CLEANING, 3, padding=1),
            nn.ReLU(),
            nn.Conv3d(CLEANING, CLEANING, 3, padding=1),
            nn.ReLU(),
            nn.Conv3d(CLEANING, 1, 3, padding=1),
        )
        self.sharpness = nn.Parameter(torch.tensor(2.0))
        self.doubt = nn.Sequential(nn.Conv2d(MIDDLE_WIDTH + 3, 16, 1), nn.ReLU(), nn.Conv2d(16, 1, 1))
        self.spread = nn.Conv2d(MIDDLE_WIDTH, 9 * CELL * CELL, 3, padding=1)

    def forward(self, middle: Tensor, views: Views, view: int) -> Swept:
        """Sweep one view from `middle` [V, M, h, w] of the encoder, with the cameras believed to stand as `views`."""
        features = functional.normalize(self.compare(middle).unflatten(1, (GROUPS, -1)), dim=2)
        steps = inverse_depths(views, STEPS).to(middle.dtype)
        volume = correlations(features, views.to(middle.dtype), view, steps)  # [2 G, K, h, w]
        raw = volume[GROUPS:].mean(dim=0) * self.sharpness.exp()
        logits = raw + self.clean(volume[None])[0, 0]
        coarse, sure = likeliest(logits, steps)
        share = logits.softmax(dim=0)
        entropy = -(share * (share + 1e-9).log()).sum(dim=0)
        told = torch.cat([middle[view], sure[None], entropy[None], volume[:GROUPS].mean(dim=0).amax(0)[None]])
        doubt = self.doubt(told[None])
        weights = self.spread(functional.relu(middle[view, None])).unflatten(1, (9, CELL * CELL)).softmax(dim=1)
        inverse_depth = self._spread(coarse[None, None], weights)
        confidence = 1 + self._spread(doubt, weights).clamp(-8, NO_DOUBT).exp()
        return Swept(logits, inverse_depth[0, 0], confidence[0, 0])

    def _spread(self, coarse: Tensor, weights: Tensor) -> Tensor:
        """Enlarge [1, 1, h, w] to [1, 1, H, W] by means of the 3x3 cells around, with `weights` [1, 9, 16, h, w]."""
        rows, columns = coarse.shape[2:]
        around = functional.unfold(functional.pad(coarse, (1, 1, 1, 1), mode="replicate"), 3)
        around = around.reshape(1, 9, 1, rows, columns)
        return functional.pixel_shuffle((weights * around).sum(dim=1), CELL)


def likeliest(logits: Tensor, steps: Tensor) -> tuple[Tensor, Tensor]:
    """Return the mean inverse depth [h, w] around the likeliest of `steps` [K], and the probability that lies there."""
    share = logits.softmax(dim=0)
    best = logits.argmax(dim=0, keepdim=True)
    near = (torch.arange(len(steps))[:, None, None] - best).abs() <= AROUND
    held = share * near
    total = held.sum(dim=0)
    return (held * steps[:, None, None]).sum(dim=0) / total.clamp_min(1e-9), total


def correlations(features: Tensor, views: Views, view: int, steps: Tensor) -> Tensor:
    """Return each group's best and mean correlation over the nearest other views [2 G, K, h, w]; 0 where unseen.

    `features` [V, G, c, h, w] of unit length along c.
    """
    rows, columns = features.shape[3:]
    far = (views.center - views.center[view]).norm(dim=1)
    sources = [int(v) for v in far.argsort() if v != view][:MOST_SOURCES]
    y, x = torch.meshgrid(torch.arange(rows) + 0.5, torch.arange(columns) + 0.5, indexing="ij")
    pixels = CELL * torch.stack([x, y], dim=-1).reshape(1, -1, 2).to(features.dtype)
    one, others = views.select([view]), views.select(sources)
    extent = CELL * torch.tensor([columns, rows], dtype=features.dtype)
    alike, seen = [], []
    spread = pixels.expand(len(steps), -1, -1).reshape(1, -1, 2)
    at, ratio = one.seen_from(others, spread, steps.repeat_interleave(rows * columns)[None])
    grid = (2 * at[0] / extent - 1).reshape(len(steps), rows * columns, len(sources), 2)
    visible = (grid.abs() <= 1).all(dim=-1) & (ratio.reshape(grid.shape[:-1]) > LEAST_Z)
    for number, source in enumerate(sources):
        place = grid[None, :, :, number].clamp(-2, 2).flatten(1, 2)[:, None]
        warped = functional.grid_sample(features[source].flatten(0, 1)[None], place, align_corners=False)
        warped = warped.reshape(*features.shape[1:3], len(steps), rows, columns)
        mask = visible[:, :, number].reshape(len(steps), rows, columns)
        alike.append((features[view][:, :, None] * warped).sum(dim=1) * mask)
        seen.append(mask)
    stacked, counted = torch.stack(alike), torch.stack(seen).sum(dim=0)
    best = torch.where(torch.stack(seen)[:, None], stacked, -torch.ones_like(stacked)).amax(dim=0)
    best = torch.where(counted > 0, best, torch.zeros_like(best))
    return torch.cat([best, stacked.sum(dim=0) / counted.clamp_min(1)])
