"""`viewer.json` and `viewer.bin`: what a browser needs to play a scene in space and time.

Letters: N Gaussians, the still ones first, then M that move; K keyframes. The arrays lie in `viewer.bin` one after
another, little-endian float32; `viewer.json` has their places, the cameras, and the kind of motion. A `polynomial` is
evaluated by the browser: `means` are at each Gaussian's own instant, `opacities` before the gate. Any other model is
`keyframes`, K even instants over the clip: `means` to `scales` are those of the middle key, `opacities` the largest of
any key, and neighbouring quaternions lie in one hemisphere, so that they can be interpolated as numbers. `key_scales`
and `key_intensities` are there where these change. Flickering light is shown steady. Gaussians that are under 1/255 all
the time are left out.

A scene of spans has version 2. Its `arrays` are those of the still Gaussians alone, at the beginning of `viewer.bin`.
Each of `spans` has its own bytes, `length` from `offset` on, and says where its arrays begin in them. `changed` [C]
uint32 are still Gaussians, numbered as they are stored, that have `changed_opacities` and `changed_intensities` in this
span. The other arrays are those of M movers as above, over a clip of their own, `clip_s`, which may reach over the ends
of the span.
But rigid ones are `bodies`, K with P `knots` each: `knot_quats` [K, P, 4] and `knot_centers` [K, P, 3], between which
`gaussians.rigid` says how they move. A mover whose number in `bodies` [M] uint32 is below K has its `means` and
`quats_wxyz` in the frame of that body, and its `velocities` beside it, in the rig's; any other is a polynomial.

Where the run has evidence, `expected_error` has `places` [P, 3] in m, and `of_white` [P]: the root mean square that the
error is expected to have from there, over white.

`dilation_px2` is what a renderer adds to the covariance of a splat, px^2, while its energy stays. A document without it
means 0.3.

A part of a scene has version 2 too: the spans that it touches, cut to it, or one where there are none.
"""

from pathlib import Path
from typing import IO, Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from acquisition.durable import made_aside, write_durably, write_json
from reconstruction.export.scene import Choices, Scene
from reconstruction.export.splats import floats
from reconstruction.export.trust import trust_table
from reconstruction.export.viewer_arrays import Arrays, motion_of, moving_arrays, span_arrays, still_arrays
from reconstruction.gaussians.dynamic import DynamicCloud
from reconstruction.gaussians.spanned import SpanContent, SpannedScene
from reconstruction.rendering.reference import ALPHA_MIN
from reconstruction.report.display import depth_span_m
from rigs.camera import Camera

VERSION = 1
SPANNED_VERSION = 2
EMPTY_M = 1.5  # distance to look at where nothing is seen, m


def write_viewer(folder: Path, scene: Scene) -> None:
    """Write both files into `folder`, last the one that names the other's contents."""
    path = folder / "viewer.bin"
    cloud = scene.cloud
    if scene.part and isinstance(cloud, DynamicCloud | SpannedScene):
        document = _write_spans(path, scene, SpannedScene.over(cloud, scene.part))
    elif isinstance(cloud, SpannedScene):
        document = _write_spans(path, scene, cloud)
    else:
        document, data = viewer_of(scene)
        write_durably(path, data)
    write_json(folder / "viewer.json", document)


@torch.no_grad()
def viewer_of(scene: Scene) -> tuple[dict, bytes]:
    """Return the document of `viewer.json` and the bytes of `viewer.bin` of a scene without spans."""
    cloud = scene.gaussians_at(scene.clip.middle_s)
    still = still_arrays(cloud.still.select(cloud.still.opacity_logits.sigmoid() >= ALPHA_MIN))
    moving = moving_arrays(cloud)
    count, movers = len(still["means"]), len(moving["means"])
    arrays = {name: np.concatenate([array, moving[name]]) for name, array in still.items()}
    arrays |= {name: array for name, array in moving.items() if name not in still and movers}
    arrays = _of_white(arrays, scene.white)
    places, data = {}, b""
    for name, array in arrays.items():
        places[name] = _place(array, len(data))
        data += _raw(array)
    return {**_counts(scene, VERSION, count, movers), **motion_of(arrays), **_surroundings(scene, places)}, data


@torch.no_grad()
def _write_spans(path: Path, scene: Scene, cloud: SpannedScene) -> dict:
    """Write the bytes of a scene of spans, one span in memory at a time; return its document."""
    kept = _ever_seen(cloud)
    still = _of_white(still_arrays(cloud.still.select(kept)), scene.white)
    with made_aside(path) as aside, aside.open("wb") as file:
        places = {
            name: _place(array, start) for (name, array), start in zip(still.items(), _append(file, still), strict=True)
        }
        spans = [_write_span(file, content, kept, scene.white) for content in cloud.spans]
    counts = _counts(scene, SPANNED_VERSION, len(still["means"]), sum(span["moving"] for span in spans))
    return {**counts, **_surroundings(scene, places), "spans": spans}


def _of_white(arrays: Arrays, white: float) -> Arrays:
    """Return the arrays with light in parts of white, in place of spikes per tick."""
    return {name: a / np.float32(white) if name.endswith("intensities") else a for name, a in arrays.items()}


def _ever_seen(cloud: SpannedScene) -> Tensor:
    """Return which still Gaussians [N] are seen in the recording as a whole or in any span."""
    seen = cloud.still.opacity_logits.sigmoid() >= ALPHA_MIN
    for content in cloud.spans:
        seen[content.changed[content.opacity_logits.sigmoid() >= ALPHA_MIN]] = True
    return seen


def _write_span(file: IO[bytes], content: SpanContent, kept: Tensor, white: float) -> dict:
    """Append the arrays of a span; return what the document says of it."""
    moving = span_arrays(content.cloud) if content.cloud else {}
    movers = len(moving["means"]) if moving else 0
    arrays = _changed(content, kept)
    changed = len(arrays["changed"]) if arrays else 0
    arrays = _of_white(arrays | (moving if movers else {}), white)
    offset = file.tell()
    starts = _append(file, arrays)
    clip = content.cloud.clip if content.cloud else content.clip
    return {
        "first_s": content.clip.first_s,
        "last_s": content.clip.last_s,
        "offset": offset,
        "length": file.tell() - offset,
        "changed": changed,
        "moving": movers,
        "clip_s": [clip.first_s, clip.last_s],
        **motion_of(arrays),
        "arrays": {name: start - offset for name, start in zip(arrays, starts, strict=True)},
    }


def _changed(content: SpanContent, kept: Tensor) -> Arrays:
    """Return what a span shows otherwise of the still Gaussians that are kept, numbered among these."""
    own = kept[content.changed]
    if not own.any():
        return {}
    return {
        "changed": (kept.cumsum(0) - 1)[content.changed[own]].numpy(),
        "changed_opacities": floats(content.opacity_logits[own].sigmoid()),
        "changed_intensities": floats(content.intensities[own, 0]),
    }


def _append(file: IO[bytes], arrays: Arrays) -> list[int]:
    """Append arrays to a file; return where each begins."""
    starts = []
    for array in arrays.values():
        starts.append(file.tell())
        file.write(_raw(array))
    return starts


def _raw(array: NDArray[Any]) -> bytes:
    return np.ascontiguousarray(array, "<f4" if array.dtype.kind == "f" else "<u4").tobytes()


def _place(array: NDArray[Any], offset: int) -> dict:
    return {"offset": offset, "shape": list(array.shape), "dtype": "float32"}


def _counts(scene: Scene, version: int, still: int, moving: int) -> dict:
    clip, cloud = scene.clip, scene.gaussians_at(scene.clip.middle_s)
    return {
        "version": version,
        "count": still + moving,
        "still": still,
        "moving": moving,
        "clip_s": [clip.first_s, clip.last_s],
        "dilation_px2": cloud.dilation_px2,
        "white": scene.white,
        "model": scene.model,
    }


def _surroundings(scene: Scene, places: dict) -> dict:
    cameras = [_camera_table(camera, scene.holdout) for camera in scene.rig.cameras]
    seen = _seen(scene)
    trust = trust_table(scene, np.array(seen["centre"]))
    return {"arrays": places, "cameras": cameras, **seen, **({"expected_error": trust} if trust else {})}


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
    depth = scene.cloud.look(camera, scene.clip.middle_s).depth
    rows, columns = np.nonzero(np.isfinite(depth))
    z = depth[rows, columns].astype(np.float64)
    if z.size:
        places = np.stack([(columns + 0.5 - camera.cx) / camera.fx * z, (rows + 0.5 - camera.cy) / camera.fy * z, z])
        middle = np.median(places, axis=1)
    else:
        middle = np.array([0, 0, EMPTY_M])
    centre = camera.cam_from_rig.inverse().apply(middle)
    return {"centre": centre.tolist(), "depth_m": list(depth_span_m(depth))}
