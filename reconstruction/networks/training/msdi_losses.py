"""The losses of MSDI: correspondences, depth and relative poses of rendered scenes, whose truth is exact.

Letters: V = W views, N tokens a view, S fine cells, K inverse depths.
"""

import torch
from torch import Tensor
from torch.nn import functional

from reconstruction.networks.msdi.adjustment import Stage, adjust
from reconstruction.networks.msdi.depth import CELL, STEPS, Swept
from reconstruction.networks.msdi.encoder import Encoded
from reconstruction.networks.msdi.features import FINE, PATCH
from reconstruction.networks.msdi.matching import OUTSIDE, WINDOW, Matcher, Matches, moments
from reconstruction.networks.msdi.views import Views, inverse_depths

SAME_SURFACE = 0.03  # largest gap in depth at which another view still sees a point, as a share
UNSEEN = -1  # token index of a point another view does not see; IGNORED where nobody knows
IGNORED = -2
SHORT = (Stage(2, 30.0, 1e-4, 1e-5), Stage(2, 5.0, 0.01, 0.01), Stage(2, 3.0, 0.02, 0.02))
ANGLE_BEND = 0.01  # rad
WORST = 0.5  # relative depth error beyond which a pixel says no more
CONFIDENCE_COST = 0.2  # DUSt3R's alpha


def depth_at(depth: Tensor, pixels: Tensor) -> Tensor:
    """Return the depth [V, ...] of the pixel that each of `pixels` [V, ..., 2] lies in; NaN outside."""
    views, rows, columns = depth.shape
    x, y = pixels[..., 0].floor().long(), pixels[..., 1].floor().long()
    inside = (x >= 0) & (x < columns) & (y >= 0) & (y < rows)
    index = (y.clamp(0, rows - 1) * columns + x.clamp(0, columns - 1)).reshape(views, -1)
    found = depth.reshape(views, -1).gather(1, index).reshape(x.shape)
    return torch.where(inside, found, torch.full_like(found, torch.nan))


def correspondences(depth: Tensor, true: Views, pixels: Tensor) -> tuple[Tensor, Tensor]:
    """Return where the other views truly see `pixels` [V, N, 2]: pixels [V, N, W, 2] and tokens [V, N, W].

    A token is UNSEEN where the point is hidden or outside, IGNORED where it has no depth or the view is its own.
    """
    own = depth_at(depth, pixels)
    known = torch.isfinite(own) & (own > 0)
    seen, ratio = true.seen_from(true, pixels.double(), torch.where(known, 1 / own, torch.ones_like(own)).double())
    there = depth_at(depth, seen.permute(2, 0, 1, 3)).permute(1, 2, 0)  # of view w at the place, [V, N, W]
    expected = own[..., None] * ratio
    visible = (ratio > 0) & ((there - expected).abs() < SAME_SURFACE * expected)
    columns = depth.shape[2] // PATCH
    at = torch.where(visible[..., None], seen, torch.zeros_like(seen)).div(PATCH).floor().long()
    tokens = torch.where(visible, at[..., 1] * columns + at[..., 0], torch.full_like(at[..., 0], UNSEEN))
    itself = torch.eye(len(depth), dtype=torch.bool)[:, None]
    return seen.float(), tokens.masked_fill(itself | ~known[..., None], IGNORED)


def token_loss(logs: Tensor, tokens: Tensor, allowed: Tensor) -> Tensor:
    """Return minus the log-probability of the true token, or of none, both ways, for pairs inside the gate."""
    held = allowed.gather(-1, tokens.clamp_min(0)[..., None])[..., 0]
    visible, unseen = (tokens >= 0) & held, tokens == UNSEEN
    index = torch.where(tokens >= 0, tokens, torch.full_like(tokens, logs.shape[-1] - 1))
    forward = -logs.gather(-1, index[..., None])[..., 0]
    backward = -logs[..., :-1].permute(2, 3, 0, 1).gather(-1, tokens.clamp_min(0)[..., None])[..., 0]
    total = (forward + backward)[visible].sum() + 0.5 * forward[unseen].sum()
    return total / (2 * visible.sum() + unseen.sum()).clamp_min(1)


def fine_loss(matcher: Matcher, encoded: Encoded, pixels: Tensor, truth: tuple[Tensor, Tensor], seed: int) -> Tensor:
    """Return the cross entropy of the fine cells, the true place spread over four neighbours, and the mean's error.

    The windows stand where the coarse match might have put them: at the true token or, as drawn, beside it.
    """
    seen, tokens = truth
    generator = torch.Generator("cpu").manual_seed(seed)
    columns = encoded.fine.shape[3] * FINE // PATCH
    shift = torch.randint(-1, 2, (2, *tokens.shape), generator=generator, device="cpu").to(tokens)
    middle = _middle(tokens, columns) + PATCH * torch.stack([shift[0], shift[1]], dim=-1)
    last = torch.tensor([columns * PATCH, encoded.fine.shape[2] * FINE])
    reach = FINE * (WINDOW // 2) - 1
    stays = ((middle - seen).abs() < reach).all(-1) & ((middle > 0) & (middle < last)).all(-1)
    drawn = torch.where(stays, tokens + shift[0] + shift[1] * columns, tokens)
    losses, count = [], 0
    for v in range(len(pixels)):
        logits, centers = matcher.window_logits(encoded.fine, pixels[v], drawn[v].clamp_min(0), v)
        kept = tokens[v] >= 0
        logits, centers, place = logits[kept], centers[kept], seen[v][kept]
        labels = (1 - (centers - place[:, None]).abs() / FINE).clamp_min(0).prod(dim=-1) * (logits > OUTSIDE)
        labels = labels / labels.sum(dim=-1, keepdim=True).clamp_min(0.25)
        mean, covariance = moments(logits, centers)
        error = (mean - place).norm(dim=-1)
        sure = covariance.detach().diagonal(dim1=-2, dim2=-1).sum(-1).rsqrt()
        losses.append((-(labels * logits.log_softmax(-1)).sum(-1) + 0.5 * sure * error.clamp_max(4.0)).sum())
        count += int(kept.sum())
    return torch.stack(losses).sum() / max(1, count)


def _middle(tokens: Tensor, columns: int) -> Tensor:
    """Return where the windows of `tokens` [...] are centred [..., 2] in px."""
    held = tokens.clamp_min(0)
    at = torch.stack([held % columns, torch.div(held, columns, rounding_mode="floor")], dim=-1)
    return at * PATCH + PATCH // 2 + FINE / 2


def depth_loss(swept: Swept, depth: Tensor, views: Views) -> Tensor:
    """Return one view's loss against the true `depth` [H, W]: entropy of steps, and DUSt3R's weighted error."""
    steps = inverse_depths(views, STEPS).to(depth.dtype)
    known = torch.isfinite(depth) & (depth > 1 / steps[-1]) & (depth < 1 / steps[0])
    inverse = 1 / torch.where(known, depth, torch.full_like(depth, views.distance))
    coarse, coarse_known = inverse[CELL // 2 :: CELL, CELL // 2 :: CELL], known[CELL // 2 :: CELL, CELL // 2 :: CELL]
    place = (coarse - steps[0]) / (steps[1] - steps[0])
    labels = (1 - (torch.arange(STEPS)[:, None, None] - place).abs()).clamp_min(0)
    entropy = -(labels * swept.logits.log_softmax(dim=0)).sum(dim=0)
    error = ((swept.inverse_depth - inverse).abs() / inverse).clamp_max(WORST)
    weighted = swept.confidence * error - CONFIDENCE_COST * swept.confidence.log()
    return _mean(entropy, coarse_known) + _mean(weighted + error, known)


def _mean(values: Tensor, where: Tensor) -> Tensor:
    return (values * where).sum() / where.sum().clamp_min(1)


def pose_loss(nominal: Views, true: Views, matches: Matches) -> Tensor:
    """Return the angles between every two views' turns and directions, against the true ones, after a short adjustment.

    Both stay as they are under the similarity that no camera can know.
    """
    found = adjust(nominal, matches, SHORT).views
    turn, truth = (torch.einsum("vab,wcb->vwac", v.rotation, v.rotation) for v in (found, true))
    difference = (turn - truth).square().sum(dim=(-2, -1)) / 2  # the squared angle, for small ones
    apart = ~torch.eye(len(true), dtype=torch.bool)
    ways = []
    for views in (found, true):
        way = torch.einsum("vab,vwb->vwa", views.rotation, views.center[None] - views.center[:, None])
        ways.append(functional.normalize(way[apart], dim=-1))
    aside = (ways[0] - ways[1]).square().sum(dim=-1)
    squares = torch.cat([difference[apart], aside]) / ANGLE_BEND**2
    return ((1 + squares).sqrt() - 1).clamp_max(10.0).mean().float()
