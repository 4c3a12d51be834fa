"""`viewer.json` and `viewer.bin`: what a browser needs to play a scene in space and time.

Letters: N Gaussians, the still ones first, then M that move; K keyframes. The arrays lie in `viewer.bin` one after
another, little-endian float32; `viewer.json` has their places, the cameras, and the kind of motion. A `polynomial` is
evaluated by the browser: `means` are at each Gaussian's own instant, `opacities` before the gate. Any other model is
`keyframes`, K even instants over the clip: `means` to `scales` are those of the middle key, `opacities` the largest of
any key, and neighbouring quaternions lie in one hemisphere, so that they can be interpolated as numbers. Flickering
light is shown steady. Gaussians that are under 1/255 all the time are left out.
"""

from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from acquisition.durable import write_durably, write_json
from reconstruction.export.scene import Choices, Scene
from reconstruction.export.splats import Floats, floats, linear_scales
from reconstruction.gaussians.course import LEAST_DURATION, MOST_DURATION
from reconstruction.gaussians.dynamic import DynamicCloud
from reconstruction.gaussians.polynomial import PolynomialMotion
from reconstruction.quaternions import unit
from reconstruction.rendering.reference import ALPHA_MIN
from reconstruction.report.display import depth_span_m
from rigs.camera import Camera

VERSION = 1
KEYFRAMES = 24
EMPTY_M = 1.5  # distance to look at where nothing is seen, m

Arrays = dict[str, Floats]


def write_viewer(folder: Path, scene: Scene) -> None:
    """Write both files into `folder`, last the one that names the other's contents."""
    document, data = viewer_of(scene)
    write_durably(folder / "viewer.bin", data)
    write_json(folder / "viewer.json", document)


@torch.no_grad()
def viewer_of(scene: Scene) -> tuple[dict, bytes]:
    """Return the document of `viewer.json` and the bytes of `viewer.bin`."""
    cloud = scene.gaussians_at(scene.cloud.clip.middle_s)
    still = _still(cloud)
    moving = _polynomial(cloud, cloud.motion) if type(cloud.motion) is PolynomialMotion else _keyframes(cloud)
    count, movers = len(still["means"]), len(moving["means"])
    arrays = {name: np.concatenate([array, moving[name]]) for name, array in still.items()}
    arrays["intensities"] = arrays["intensities"] / np.float32(scene.white)
    arrays |= {name: array for name, array in moving.items() if name not in still and movers}
    places, data = {}, b""
    for name, array in arrays.items():
        places[name] = {"offset": len(data), "shape": list(array.shape), "dtype": "float32"}
        data += np.ascontiguousarray(array, "<f4").tobytes()
    clip = scene.cloud.clip
    document = {
        "version": VERSION,
        "count": count + movers,
        "still": count,
        "moving": movers,
        "clip_s": [clip.first_s, clip.last_s],
        "white": scene.white,
        "model": scene.model,
        **_motion_of(arrays),
        "arrays": places,
        "cameras": [_camera_table(camera, scene.holdout) for camera in scene.rig.cameras],
        **_seen(scene),
    }
    return document, data


def _still(cloud: DynamicCloud) -> Arrays:
    still = cloud.still
    still = still.select(still.opacity_logits.sigmoid() >= ALPHA_MIN)
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


def _polynomial(cloud: DynamicCloud, motion: PolynomialMotion) -> Arrays:
    moving, opacities = cloud.moving, cloud.moving.opacity_logits.sigmoid()
    durations = motion.log_durations.exp().clamp(LEAST_DURATION, MOST_DURATION)
    away = (motion.instants - motion.instants.clamp(0, 1)) / durations  # from the clip, where an instant is beyond it
    kept = opacities * torch.exp(-away.square() / 2) >= ALPHA_MIN
    arrays = _base(moving.means, moving.quats_wxyz, moving.log_scales, opacities, moving.intensities)
    arrays |= {"velocities": floats(motion.velocities)}
    if len(motion.accelerations):
        arrays |= {"accelerations": floats(motion.accelerations), "jerks": floats(motion.jerks)}
    arrays |= {"instants": floats(motion.instants), "durations": floats(durations)}
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
    chosen = kept.numpy()
    return {name: a[chosen] for name, a in arrays.items()} | {name: a[:, chosen] for name, a in tracks.items()}


def _one_hemisphere(quats: Floats) -> Floats:
    """Return quaternions [K, M, 4] with signs that put each into the hemisphere of the one before it."""
    turned = np.where((quats[1:] * quats[:-1]).sum(axis=-1) < 0, -1, 1).astype(np.float32)
    signs = np.concatenate([np.ones_like(turned[:1]), turned]).cumprod(axis=0)
    return quats * signs[..., None]


def _motion_of(arrays: Arrays) -> dict:
    """Return what the document says of the motion, told by the arrays there are."""
    if "key_means" in arrays:
        return {"motion": "keyframes", "degree": 0, "keyframes": KEYFRAMES}
    degree = 3 if "jerks" in arrays else 1 if "velocities" in arrays else 0
    return {"motion": "polynomial" if degree else "static", "degree": degree, "keyframes": 0}


def _camera_table(camera: Camera, holdout: str | None) -> dict:
    return {
        "id": camera.id,
        "width": camera.width,
        "height": camera.height,
        **{name: float(getattr(camera, name)) for name in ("fx", "fy", "cx", "cy")},
        "cam_from_rig": camera.cam_from_rig.matrix.ravel().tolist(),
        "held_out": camera.id == holdout,
    }


def _seen(scene: Scene) -> dict:
    """Return the middle of the default camera's view half-way through the clip, and the span of its depth."""
    camera = scene.camera(Choices())
    depth = scene.cloud.look(camera, scene.cloud.clip.middle_s).depth
    rows, columns = np.nonzero(np.isfinite(depth))
    z = depth[rows, columns].astype(np.float64)
    if z.size:
        places = np.stack([(columns + 0.5 - camera.cx) / camera.fx * z, (rows + 0.5 - camera.cy) / camera.fy * z, z])
        middle = np.median(places, axis=1)
    else:
        middle = np.array([0, 0, EMPTY_M])
    centre = camera.cam_from_rig.inverse().apply(middle)
    return {"centre": centre.tolist(), "depth_m": list(depth_span_m(depth))}
