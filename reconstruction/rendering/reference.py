"""The renderer in plain torch: any float type, autograd only. The truth the fast backends are tested against.

Letters: N Gaussians, H rows, W columns, C channels, P pixels of a block of rows.
EWA splatting (Zwicker 2001; Kerbl 2023) with gsplat's guards: near plane, clamped Jacobian, covariance + 0.3 px^2 with
the opacity scaled by sqrt(det / det_blurred) (gsplat's "antialiased"), alpha <= 0.99, nothing below 1/255, and nothing
more where the transmittance is below 1e-4.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from reconstruction.rendering.pinhole import Pinhole

LOG_SCALE_MIN, LOG_SCALE_MAX = -30.0, 15.0
DILATION_PX2 = 0.3
ALPHA_MAX = 0.99
ALPHA_MIN = 1 / 255
TRANSMITTANCE_MIN = 1e-4
HALF = 0.5  # of the light: what takes it there is where a pixel's median depth lies
PAIRS_AT_ONCE = 4_000_000


@dataclass(frozen=True)
class Splats:
    """Projected Gaussians, nearest first; `source` says which ones they were."""

    means2d: Tensor  # [M, 2] px
    factors: Tensor  # [M, 3] p, q, r: sigma = (p dx + q dy)^2 + (r dy)^2
    opacities: Tensor  # [M]
    depths: Tensor  # [M] m
    radii: Tensor  # [M] px
    source: Tensor  # [M]


def unit_quats(quats_wxyz: Tensor) -> Tensor:
    """Quaternions [N, 4] of any length at length one; no rotation where all four numbers are zero."""
    largest = quats_wxyz.abs().amax(-1, keepdim=True).detach()
    some = largest > 0
    # Scaled first, so that 1e20 and 1e-20 survive the squares.
    scaled = torch.where(some, quats_wxyz / torch.where(some, largest, 1), quats_wxyz.new_tensor([1.0, 0, 0, 0]))
    return scaled / scaled.norm(dim=-1, keepdim=True)


def rotations_of(quats_wxyz: Tensor) -> Tensor:
    """Rotation matrices [N, 3, 3] of quaternions [N, 4] of any length; the identity where all four are zero."""
    w, x, y, z = unit_quats(quats_wxyz).unbind(-1)
    rows = [
        *(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        *(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        *(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    ]
    return torch.stack(rows, -1).unflatten(-1, (3, 3))


def clamped_slopes(in_cam: Tensor, camera: Pinhole) -> tuple[Tensor, Tensor]:
    """x/z and y/z, held within 15% of the image's size around it, where the projection is still nearly linear."""
    slopes = []
    for axis, size in enumerate((camera.width, camera.height)):
        focal, principal = camera.focal[axis], camera.principal[axis]
        low, high = (-principal - 0.15 * size) / focal, (size - principal + 0.15 * size) / focal
        slopes.append((in_cam[:, axis] / in_cam[:, 2]).clamp(low, high))
    return slopes[0], slopes[1]


def projected_axes(in_cam: Tensor, quats_wxyz: Tensor, log_scales: Tensor, camera: Pinhole) -> Tensor:
    """[N, 2, 3]: the image of each Gaussian's scaled axes; times its transpose, the covariance in px^2."""
    z = in_cam[:, 2]
    slope_x, slope_y = clamped_slopes(in_cam, camera)
    zero = torch.zeros_like(z)
    fx, fy = camera.focal
    jacobian = torch.stack([fx / z, zero, -fx * slope_x / z, zero, fy / z, -fy * slope_y / z], -1).unflatten(-1, (2, 3))
    rotation = in_cam.new_tensor(camera.rotation).reshape(3, 3)
    scales = log_scales.clamp(LOG_SCALE_MIN, LOG_SCALE_MAX).exp()
    return jacobian @ rotation @ (rotations_of(quats_wxyz) * scales[:, None, :])


def in_camera(means: Tensor, camera: Pinhole) -> Tensor:
    """World points [N, 3] in the camera's frame."""
    rotation = means.new_tensor(camera.rotation).reshape(3, 3)
    return means @ rotation.T + means.new_tensor(camera.translation)


def project(means: Tensor, quats_wxyz: Tensor, log_scales: Tensor, opacities: Tensor, camera: Pinhole) -> Splats:
    """The Gaussians that reach at least one pixel, in order of depth (equal depths keep their order)."""
    in_front = (in_camera(means.detach(), camera)[:, 2] >= camera.near_m).nonzero()[:, 0]
    in_cam = in_camera(means[in_front], camera)
    axes = projected_axes(in_cam, quats_wxyz[in_front], log_scales[in_front], camera)
    (a, b, c), (d, e, f) = axes[:, 0].unbind(-1), axes[:, 1].unbind(-1)
    det = (a * e - b * d) ** 2 + (a * f - c * d) ** 2 + (b * f - c * e) ** 2  # Cauchy-Binet: never negative
    xx, xy, yy = (axes[:, 0] ** 2).sum(-1), (axes[:, 0] * axes[:, 1]).sum(-1), (axes[:, 1] ** 2).sum(-1)
    det_blurred = det + DILATION_PX2 * (xx + yy) + DILATION_PX2**2
    xx, yy = xx + DILATION_PX2, yy + DILATION_PX2
    kept = det > 0
    opacity = opacities[in_front] * torch.where(kept, torch.where(kept, det, 1) / det_blurred, 0).sqrt()
    p = (yy / det_blurred / 2).sqrt()
    factors = torch.stack([p, -p * xy / yy, (0.5 / yy).sqrt()], -1)
    means2d = in_cam[:, :2] / in_cam[:, 2:] * in_cam.new_tensor(camera.focal) + in_cam.new_tensor(camera.principal)
    with torch.no_grad():
        reach = (2 * (255 * opacity).log()[:, None] * torch.stack([xx, yy], -1)).clamp_min(0).sqrt()
        size = means2d.new_tensor([camera.width, camera.height])
        first, last = (means2d - reach - 0.5).clamp_min(0).ceil(), (means2d + reach - 0.5).minimum(size - 1).floor()
        kept = (opacity > ALPHA_MIN) & (first <= last).all(-1)
        order = kept.nonzero()[:, 0]
        order = order[in_cam[order, 2].float().argsort(stable=True)]
        radii = reach.amax(-1).ceil()
    return Splats(means2d[order], factors[order], opacity[order], in_cam[order, 2], radii[order], in_front[order])


def alphas_of(splats: Splats, pixels: Tensor) -> Tensor:
    """Opacity [P, M] of every splat at pixel centres [P, 2]."""
    offset = pixels[:, None] - splats.means2d
    p, q, r = splats.factors.unbind(-1)
    sigma = (p * offset[..., 0] + q * offset[..., 1]) ** 2 + (r * offset[..., 1]) ** 2
    inside = sigma <= (255 * splats.opacities).log()
    return torch.where(inside, (splats.opacities * torch.exp(-sigma)).clamp_max(ALPHA_MAX), 0)


def transmittance_before(alphas: Tensor) -> Tensor:
    """Light [P, M + 1] left before each splat and after the last."""
    return torch.cat([torch.ones_like(alphas[:, :1]), (1 - alphas).cumprod(-1)], -1)


def composite(splats: Splats, intensities: Tensor, pixels: Tensor) -> Tensor:
    """[P, C + 2]: intensity, depth and alpha at pixel centres [P, 2], front to back."""
    alphas = alphas_of(splats, pixels)
    live = transmittance_before(alphas.detach())[:, :-1] >= TRANSMITTANCE_MIN
    alphas = torch.where(live, alphas, 0)
    weights = transmittance_before(alphas)[:, :-1] * alphas
    colours = torch.cat([intensities, splats.depths[:, None], torch.ones_like(splats.depths[:, None])], -1)
    return weights @ colours


@torch.no_grad()
def median_depths(splats: Splats, pixels: Tensor) -> Tensor:
    """Depth [P] of the splat that takes the light at pixel centres [P, 2] to a half or below; NaN where none does."""
    before = transmittance_before(alphas_of(splats, pixels))
    falls = (before[:, :-1] > HALF) & (before[:, 1:] <= HALF)
    return torch.where(falls, splats.depths, 0).sum(-1).where(falls.any(-1), torch.nan)


def render_reference(
    means: Tensor,
    quats_wxyz: Tensor,
    log_scales: Tensor,
    opacities: Tensor,
    intensities: Tensor,
    camera: Pinhole,
    *,
    median: bool = False,
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor | None]:
    """Intensity [H, W, C], accumulated depth [H, W], alpha [H, W] and radii [N] (int32 px, 0 where culled).

    Last the median depth [H, W] if it is asked for, else None.
    """
    splats = project(means, quats_wxyz, log_scales, opacities, camera)
    rows = max(1, PAIRS_AT_ONCE // max(1, len(splats.source) * camera.width))
    x = torch.arange(camera.width, dtype=means.dtype, device=means.device) + 0.5
    blocks, medians = [], []
    for top in range(0, camera.height, rows):
        y = torch.arange(top, min(top + rows, camera.height), dtype=means.dtype, device=means.device) + 0.5
        pixels = torch.stack([x.expand(len(y), -1), y[:, None].expand(-1, len(x))], -1).reshape(-1, 2)
        blocks.append(composite(splats, intensities[splats.source], pixels))
        if median:
            medians.append(median_depths(splats, pixels))
    image = torch.cat(blocks).reshape(camera.height, camera.width, -1)
    radii = torch.zeros(len(means), dtype=torch.int32, device=means.device)
    radii[splats.source] = splats.radii.clamp_max(1e9).int()
    middle = torch.cat(medians).reshape(camera.height, camera.width) if median else None
    return image[..., :-2], image[..., -2], image[..., -1], radii, middle
