"""Correspondences of all pairs of views: tokens by dual softmax inside the gate, then fine cells to a fraction of a px.

As in LoFTR (Sun et al., CVPR 2021), but a query is the keypoint of its patch, every softmax may choose "none", and a
correspondence carries the inverse covariance of where the fine correlation lies instead of one number: along an edge it
says little, across it much. Letters: V = W views, N tokens a view, S = WINDOW^2 fine cells.
"""

from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from reconstruction.networks.msdi.encoder import FINE_WIDTH, TOKEN_WIDTH, Encoded
from reconstruction.networks.msdi.features import FINE, PATCH

PEAK = 1  # fine cells to either side of the likeliest that a correspondence is the mean of
WINDOW = 9  # fine cells a side around a token's middle
LEAST_CONFIDENCE = 0.1
OUTSIDE = -1e4  # logit of a forbidden choice
FLOOR_PX = 0.35  # standard deviation of the best correspondence
WIDEST_PX = 3.0  # a correlation spread wider than this in every direction says nothing


class Matches(NamedTuple):
    """`pixels` [V, N, 2] of each view seen at `found` [V, N, W, 2] px in the others, with `information` [..., 2, 2].

    The information is the inverse covariance in px^-2; zero: no correspondence.
    """

    pixels: Tensor
    found: Tensor
    information: Tensor


class Matcher(nn.Module):
    """The correlations, with their learnt projections and temperatures."""

    def __init__(self) -> None:
        super().__init__()
        self.coarse = nn.Linear(TOKEN_WIDTH, TOKEN_WIDTH)
        self.fine = nn.Linear(FINE_WIDTH, FINE_WIDTH)
        self.sharpness = nn.Parameter(torch.tensor([2.5, 2.5]))  # logarithms, coarse and fine
        self.none = nn.Parameter(torch.zeros(()))

    def token_logs(self, tokens: Tensor, gate: Tensor) -> Tensor:
        """Return each token's log-probabilities [V, N, W, N + 1] of the tokens of view w, and of none (the last)."""
        unit = functional.normalize(self.coarse(tokens), dim=-1)
        alike = torch.einsum("vnd,wmd->vnwm", unit, unit) * self.sharpness[0].exp()
        alike = alike.masked_fill(~gate, OUTSIDE)
        none = self.none.expand(*alike.shape[:3], 1)
        return torch.cat([alike, none], dim=-1).log_softmax(dim=-1)

    def window_logits(self, fine: Tensor, queries: Tensor, chosen: Tensor, view: int) -> tuple[Tensor, Tensor]:
        """Correlate view `view` with the windows around the tokens `chosen` [N, W]; return logits and cells.

        `queries` [N, 2] px lie in that view. Logits [N, W, S]; the cells' centres [N, W, S, 2] in px. Cells outside the
        picture have the logit OUTSIDE.
        """
        views, _, rows, columns = fine.shape
        unit = functional.normalize(self.fine(fine.flatten(2).transpose(1, 2)), dim=-1)  # [W, h w, F]
        at = (queries / FINE).long()
        query = unit[view, at[:, 1] * columns + at[:, 0]]
        x, y = window_cells(chosen, columns)
        inside = (x >= 0) & (x < columns) & (y >= 0) & (y < rows)
        index = y.clamp(0, rows - 1) * columns + x.clamp(0, columns - 1)
        seen = unit[torch.arange(views)[None, :, None], index]  # [N, W, S, F]
        logits = torch.einsum("nf,nwsf->nws", query, seen) * self.sharpness[1].exp()
        centers = (torch.stack([x, y], dim=-1) + 0.5) * FINE
        return logits.masked_fill(~inside, OUTSIDE), centers.to(fine.dtype)

    def forward(self, encoded: Encoded, pixels: Tensor, gate: Tensor) -> Matches:
        """Match the keypoints `pixels` [V, N, 2] inside the gate [V, N, V, N]."""
        logs = self.token_logs(encoded.tokens, gate)[..., :-1]
        mutual = logs + logs.permute(2, 3, 0, 1)
        best, chosen = mutual.max(dim=-1)
        found, information = [], []
        for v in range(len(pixels)):
            logits, centers = self.window_logits(encoded.fine, pixels[v], chosen[v], v)
            mean, covariance = moments(around_peak(logits, centers), centers)
            found.append(mean)
            information.append(torch.linalg.inv(covariance))
        sure = best.exp()
        sure = torch.where((sure >= LEAST_CONFIDENCE) & torch.isfinite(sure), sure, torch.zeros_like(sure))
        sharp = torch.stack(information)
        sharp = sharp * (sure * (sharp.diagonal(dim1=-2, dim2=-1).sum(-1) > 2 / WIDEST_PX**2))[..., None, None]
        return Matches(pixels, torch.stack(found), sharp)


def window_cells(chosen: Tensor, columns: int) -> tuple[Tensor, Tensor]:
    """Return column and row [N, W, S] of the fine cells around tokens `chosen` [N, W]; `columns` fine cells a row."""
    per_patch = PATCH // FINE
    tokens = columns // per_patch
    step = torch.arange(WINDOW) - WINDOW // 2
    down, across = (part.reshape(-1) for part in torch.meshgrid(step, step, indexing="ij"))
    middle = per_patch // 2
    x = (chosen % tokens)[..., None] * per_patch + middle + across
    y = torch.div(chosen, tokens, rounding_mode="floor")[..., None] * per_patch + middle + down
    return x, y


def around_peak(logits: Tensor, centers: Tensor) -> Tensor:
    """Set the logits [..., S] of cells at `centers` [..., S, 2] more than PEAK cells from the highest to OUTSIDE.

    What little probability lies all over the window would draw the mean towards its middle.
    """
    best = logits.argmax(dim=-1)[..., None, None].expand(*logits.shape[:-1], 1, 2)
    far = ((centers - centers.gather(-2, best)).abs() > (PEAK + 0.5) * FINE).any(dim=-1)
    return logits.masked_fill(far, OUTSIDE)


def moments(logits: Tensor, centers: Tensor) -> tuple[Tensor, Tensor]:
    """Return mean [..., 2] and covariance [..., 2, 2] in px of the softmax of `logits` [..., S] at `centers`."""
    share = logits.softmax(dim=-1)[..., None]
    mean = (share * centers).sum(dim=-2)
    away = centers - mean[..., None, :]
    covariance = torch.einsum("...sa,...sb->...ab", share * away, away)
    return mean, covariance + FLOOR_PX**2 * torch.eye(2, dtype=logits.dtype)
