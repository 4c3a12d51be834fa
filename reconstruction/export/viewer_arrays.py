"""The arrays of still and moving Gaussians as the viewer's files have them; `viewer` says what each is."""

import numpy as np
import torch
from torch import Tensor

from reconstruction.export.splats import Floats, floats, linear_scales
from reconstruction.gaussians.cloud import GaussianCloud
from reconstruction.gaussians.course import LEAST_DURATION, MOST_DURATION
from reconstruction.gaussians.dynamic import DynamicCloud
from reconstruction.gaussians.polynomial import PolynomialMotion
from reconstruction.gaussians.rigid import RigidMotion
from reconstruction.quaternions import unit
from reconstruction.rendering.reference import ALPHA_MIN

KEYFRAMES = 24

Arrays = dict[str, Floats]


def still_arrays(still: GaussianCloud) -> Arrays:
    """Return the arrays of still Gaussians."""
    return _base(still.means, still.quats_wxyz, still.log_scales, still.opacity_logits.sigmoid(), still.intensities)


def _base(means: Tensor, quats: Tensor, log_scales: Tensor, opacities: Tensor, intensities: Tensor) -> Arrays:
    """Return the arrays that still and moving Gaussians share."""
    return {
        "means": floats(means),
        "quats_wxyz": floats(unit(quats)),
        "scales": linear_scales(log_scales),
        "opacities": floats(opacities),
        "intensities": floats(intensities[:, 0]),
    }


def moving_arrays(cloud: DynamicCloud) -> Arrays:
    """Return the arrays of the moving Gaussians that are ever seen, those of their motion included."""
    return _polynomial(cloud, cloud.motion) if type(cloud.motion) is PolynomialMotion else _keyframes(cloud)


def span_arrays(cloud: DynamicCloud) -> Arrays:
    """Return the same of a span, where bodies keep their knots: a tenth of the bytes of keyframes."""
    return _riding(cloud, cloud.motion) if type(cloud.motion) is RigidMotion else moving_arrays(cloud)


def _polynomial(cloud: DynamicCloud, motion: PolynomialMotion) -> Arrays:
    arrays = {"velocities": floats(motion.velocities)}
    if len(motion.accelerations):
        arrays |= {"accelerations": floats(motion.accelerations), "jerks": floats(motion.jerks)}
    return _windowed(cloud.moving, arrays, motion.instants, motion.log_durations)


def _riding(cloud: DynamicCloud, motion: RigidMotion) -> Arrays:
    bodies = torch.cat([motion.bodies, torch.full((len(motion.velocities),), len(motion.knot_quats))])
    velocities = torch.cat([motion.drifts, motion.velocities])
    own = {"velocities": floats(velocities), "bodies": bodies.numpy()}
    knots = {"knot_quats": floats(motion.knot_quats), "knot_centers": floats(motion.knot_centers)}
    return _windowed(cloud.moving, own, motion.instants, motion.log_durations) | knots


def _windowed(moving: GaussianCloud, own: Arrays, instants: Tensor, log_durations: Tensor) -> Arrays:
    """Return the arrays of Gaussians with time windows, and their `own`, without those that are never seen."""
    opacities = moving.opacity_logits.sigmoid()
    durations = log_durations.exp().clamp(LEAST_DURATION, MOST_DURATION)
    away = (instants - instants.clamp(0, 1)) / durations  # from the clip, where an instant is beyond it
    kept = opacities * torch.exp(-away.square() / 2) >= ALPHA_MIN
    arrays = _base(moving.means, moving.quats_wxyz, moving.log_scales, opacities, moving.intensities)
    arrays |= own | {"instants": floats(instants), "durations": floats(durations)}
    return {name: array[kept.numpy()] for name, array in arrays.items()}


def _keyframes(cloud: DynamicCloud) -> Arrays:
    moving = cloud.moving
    keys = [cloud.motion.at(moving, k / (KEYFRAMES - 1)) for k in range(KEYFRAMES)] if len(moving) else []
    if not keys:
        return _base(moving.means, moving.quats_wxyz, moving.log_scales, moving.opacity_logits, moving.intensities)
    opacities = torch.stack([key.opacities for key in keys])
    most = opacities.amax(dim=0)
    kept = most >= ALPHA_MIN
    middle = keys[KEYFRAMES // 2]
    arrays = _base(middle.means, middle.quats_wxyz, middle.log_scales, most, middle.intensities)
    tracks = {
        "key_means": floats(torch.stack([key.means for key in keys])),
        "key_quats": _one_hemisphere(floats(torch.stack([unit(key.quats_wxyz) for key in keys]))),
        "key_opacities": floats(opacities),
    }
    if any(not torch.equal(key.log_scales, middle.log_scales) for key in keys):
        tracks["key_scales"] = np.stack([linear_scales(key.log_scales) for key in keys])
    if any(not torch.equal(key.intensities, middle.intensities) for key in keys):
        tracks["key_intensities"] = np.stack([floats(key.intensities[:, 0]) for key in keys])
    chosen = kept.numpy()
    return {name: a[chosen] for name, a in arrays.items()} | {name: a[:, chosen] for name, a in tracks.items()}


def _one_hemisphere(quats: Floats) -> Floats:
    """Return quaternions [K, M, 4] with signs that put each into the hemisphere of the one before it."""
    turned = np.where((quats[1:] * quats[:-1]).sum(axis=-1) < 0, -1, 1).astype(np.float32)
    signs = np.concatenate([np.ones_like(turned[:1]), turned]).cumprod(axis=0)
    return quats * signs[..., None]


def motion_of(arrays: Arrays) -> dict:
    """Return what the document says of the motion, told by the arrays there are."""
    if "key_means" in arrays:
        return {"motion": "keyframes", "degree": 0, "keyframes": KEYFRAMES}
    if "knot_quats" in arrays:
        bodies, knots = arrays["knot_quats"].shape[:2]
        return {"motion": "bodies", "degree": 1, "keyframes": 0, "bodies": bodies, "knots": knots}
    degree = 3 if "jerks" in arrays else 1 if "velocities" in arrays else 0
    return {"motion": "polynomial" if degree else "static", "degree": degree, "keyframes": 0}
