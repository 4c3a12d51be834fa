"""The renderer in plain torch, for any float type: the truth that the fast backends are tested against.

Letters: N Gaussians, M splats that are seen, H rows, W columns, C channels, P pixels of a block of rows.
EWA splatting (Zwicker et al., "EWA volume splatting", 2001; Kerbl et al., "3D Gaussian splatting", 2023) with gsplat's
guards: a near plane, a clamped Jacobian, a dilation (0.17 px^2) added to the covariance and the opacity scaled by
sqrt(det / det_blurred) (gsplat's "antialiased"), alpha at most 0.99 and at least 1/255, and an end where the
transmittance is below 1e-4.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from reconstruction.quaternions import matrices
from reconstruction.rendering.result import GUARDS, Guards, Instantaneous, Rendering
from rigs.camera import Camera

LOG_SCALE_MIN, LOG_SCALE_MAX = -30.0, 15.0  # log m
ALPHA_MAX = 0.99
ALPHA_MIN = 1 / 255
TRANSMITTANCE_MIN = 1e-4
HALF = 0.5  # share of the light left at the median depth of a pixel
PAIRS_AT_ONCE = 4_000_000  # pixels times splats of a block of rows


@dataclass(frozen=True)
class Splats:
    """Projected Gaussians, nearest first."""

    means2d: Tensor  # [M, 2] px
    factors: Tensor  # [M, 3] p, q, r: sigma = (p dx + q dy)^2 + (r dy)^2
    opacities: Tensor  # [M]
    depths: Tensor  # [M] m
    radii: Tensor  # [M] px
    source: Tensor  # [M] index of the Gaussian


def clamped_slopes(in_cam: Tensor, camera: Camera) -> tuple[Tensor, Tensor]:
    """Return x/z and y/z [N] of points [N, 3] m in the camera's frame, held within 15% of the image's size around it.

    So far out the projection is still nearly linear.
    """
    slopes, lens = [], ((camera.width, camera.fx, camera.cx), (camera.height, camera.fy, camera.cy))
    for axis, (size, focal, principal) in enumerate(lens):
        low, high = (-principal - 0.15 * size) / focal, (size - principal + 0.15 * size) / focal
        slopes.append((in_cam[:, axis] / in_cam[:, 2]).clamp(low, high))
    return slopes[0], slopes[1]


def projected_axes(in_cam: Tensor, quats_wxyz: Tensor, log_scales: Tensor, camera: Camera) -> Tensor:
    """Return the images [N, 2, 3] in px of each Gaussian's scaled axes; times its transpose, the covariance in px^2.

    `in_cam` [N, 3] m in the camera's frame, `quats_wxyz` [N, 4] of any length, `log_scales` [N, 3] log m.
    """
    z = in_cam[:, 2]
    slope_x, slope_y = clamped_slopes(in_cam, camera)
    zero = torch.zeros_like(z)
    fx, fy = camera.fx, camera.fy
    jacobian = torch.stack([fx / z, zero, -fx * slope_x / z, zero, fy / z, -fy * slope_y / z], -1).unflatten(-1, (2, 3))
    rotation = in_cam.new_tensor(camera.cam_from_rig.rotation)
    scales = log_scales.clamp(LOG_SCALE_MIN, LOG_SCALE_MAX).exp()
    return jacobian @ rotation @ (matrices(quats_wxyz) * scales[:, None, :])


def in_camera(means: Tensor, camera: Camera) -> Tensor:
    """Return points [N, 3] of the rig frame in the camera's frame, in m."""
    pose = camera.cam_from_rig
    return means @ means.new_tensor(pose.rotation).T + means.new_tensor(pose.translation)


def project(
    means: Tensor, quats_wxyz: Tensor, log_scales: Tensor, opacities: Tensor, camera: Camera, guards: Guards = GUARDS
) -> Splats:
    """Return the Gaussians that reach at least one pixel, in order of depth (equal depths keep their order).

    `means` [N, 3] m in the rig frame, `quats_wxyz` [N, 4] of any length, `log_scales` [N, 3] log m, `opacities` [N] 0
    to 1. The covariance is J W V W^T J^T as in Zwicker et al., with the guards of this module.
    """
    in_front = (in_camera(means.detach(), camera)[:, 2] >= guards.near_m).nonzero()[:, 0]
    in_cam = in_camera(means[in_front], camera)
    axes = projected_axes(in_cam, quats_wxyz[in_front], log_scales[in_front], camera)
    (a, b, c), (d, e, f) = axes[:, 0].unbind(-1), axes[:, 1].unbind(-1)
    det = (a * e - b * d) ** 2 + (a * f - c * d) ** 2 + (b * f - c * e) ** 2  # Cauchy-Binet: never negative
    xx, xy, yy = (axes[:, 0] ** 2).sum(-1), (axes[:, 0] * axes[:, 1]).sum(-1), (axes[:, 1] ** 2).sum(-1)
    dilation = guards.dilation_px2
    det_blurred = det + dilation * (xx + yy) + dilation**2
    xx, yy = xx + dilation, yy + dilation
    kept = det > 0
    opacity = opacities[in_front] * torch.where(kept, torch.where(kept, det, 1) / det_blurred, 0).sqrt()
    p = (yy / det_blurred / 2).sqrt()
    factors = torch.stack([p, -p * xy / yy, (0.5 / yy).sqrt()], -1)
    focal, principal = in_cam.new_tensor((camera.fx, camera.fy)), in_cam.new_tensor((camera.cx, camera.cy))
    means2d = in_cam[:, :2] / in_cam[:, 2:] * focal + principal
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
    """Return the alpha [P, M] of every splat at pixel centres [P, 2] in px."""
    offset = pixels[:, None] - splats.means2d
    p, q, r = splats.factors.unbind(-1)
    sigma = (p * offset[..., 0] + q * offset[..., 1]) ** 2 + (r * offset[..., 1]) ** 2
    inside = sigma <= (255 * splats.opacities).log()
    return torch.where(inside, (splats.opacities * torch.exp(-sigma)).clamp_max(ALPHA_MAX), 0)


def transmittance_before(alphas: Tensor) -> Tensor:
    """Return the share of light [P, M + 1] left before each splat and after the last, of `alphas` [P, M]."""
    return torch.cat([torch.ones_like(alphas[:, :1]), (1 - alphas).cumprod(-1)], -1)


def composite(splats: Splats, intensities: Tensor, pixels: Tensor) -> Tensor:
    """Return intensity, depth and alpha [P, C + 2] at pixel centres [P, 2] in px, blended front to back.

    `intensities` [M, C] are those of the splats.
    """
    alphas = alphas_of(splats, pixels)
    live = transmittance_before(alphas.detach())[:, :-1] >= TRANSMITTANCE_MIN
    alphas = torch.where(live, alphas, 0)
    weights = transmittance_before(alphas)[:, :-1] * alphas
    colours = torch.cat([intensities, splats.depths[:, None], torch.ones_like(splats.depths[:, None])], -1)
    return weights @ colours


@torch.no_grad()
def median_depths(splats: Splats, pixels: Tensor) -> Tensor:
    """Return the depth [P] m of the splat that takes the light at pixel centres [P, 2] to a half or below, else NaN."""
    before = transmittance_before(alphas_of(splats, pixels))
    falls = (before[:, :-1] > HALF) & (before[:, 1:] <= HALF)
    return torch.where(falls, splats.depths, 0).sum(-1).where(falls.any(-1), torch.nan)


def render_reference(
    gaussians: Instantaneous, camera: Camera, guards: Guards = GUARDS, *, median: bool = False
) -> Rendering:
    """Render N Gaussians in C channels, in the float type and on the device of their means.

    Differentiable in all five tensors. `median` asks for the median depth too.
    """
    means, *_, intensities = gaussians
    splats = project(*gaussians[:4], camera, guards)
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
    return Rendering(image[..., :-2], image[..., -2], image[..., -1], radii, middle)
