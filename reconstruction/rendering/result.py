"""Names what every renderer takes and returns."""

from typing import NamedTuple

from torch import Tensor


class Instantaneous(NamedTuple):
    """Gaussians at one instant; all but the opacities are encoded as in the cloud."""

    means: Tensor  # [N, 3] m, rig frame
    quats_wxyz: Tensor  # [N, 4] of any length
    log_scales: Tensor  # [N, 3] log m
    opacities: Tensor  # [N] 0 to 1, after the motion's gate
    intensities: Tensor  # [N, C] spikes per tick


class Guards(NamedTuple):
    """The limits that a renderer holds projections to.

    `near_m`: the least depth that is seen, m. `dilation_px2`: what is added to a projected covariance, px^2, so that no
    Gaussian is lost between pixels: twice the variance of a pixel's square, 1/12. With less, a Gaussian much smaller
    than a pixel is brighter in the middle of one than between two. Source: Yu et al., "Mip-Splatting", CVPR 2024: 0.1.
    """

    near_m: float = 0.01
    dilation_px2: float = 0.17


GUARDS = Guards()


class Rendering(NamedTuple):
    """The view of N Gaussians by a camera of H rows and W columns; the mean depth of a pixel is `depth / alpha`.

    `median` is the depth of the Gaussian that takes a pixel's light to a half or below, NaN where none does. It is the
    depth of a surface, where the mean lies between the surface and what shines through it. `radii` and `median` have
    no gradient.
    """

    intensity: Tensor  # [H, W, C] spikes per tick
    depth: Tensor  # [H, W] sum of weight times z, m
    alpha: Tensor  # [H, W] 0 to 1
    radii: Tensor  # [N] int32 px, 0 where the Gaussian is not seen
    median: Tensor | None = None  # [H, W] m, where it was asked for
