"""`.glb`: binary glTF 2.0 with KHR_gaussian_splatting; a viewer without the extension shows a cloud of points.

Scales are linear, opacities as drawn, greys those of `ply`. The extension also knows linear light
(`lin_rec709_display`), whose picture would be ours exactly, but today's viewers (PlayCanvas 2, three.js) show it
undecoded and far too dark. The points of the fallback (`COLOR_0`) are linear, as glTF wants them. Axes are glTF's, y
up: half a turn about x takes means and quaternions there from the rig frame, and the scene then faces +z, the front of
a glTF asset. An empty cloud becomes a scene with an empty node, since glTF has no empty accessors.
Source: Khronos, glTF 2.0 specification 4.4 (GLB) and KHR_gaussian_splatting (ratified).
"""

import json
import struct

import numpy as np

from reconstruction.export.splats import SH_0, Splats, splat_format, to_bytes

EXTENSION = "KHR_gaussian_splatting"
FLOAT, UNSIGNED_BYTE, ARRAY_BUFFER, POINTS = 5126, 5121, 34962, 0
TYPES = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}
MAGIC, JSON_CHUNK, BIN_CHUNK = 0x46546C67, 0x4E4F534A, 0x004E4942


def glb_bytes(splats: Splats) -> bytes:
    """Return the bytes of a file of Gaussians at one instant."""
    document = {"asset": {"version": "2.0", "generator": "spike4dgs"}, "scene": 0, "scenes": [{"nodes": [0]}]}
    if not len(splats):
        return _container({**document, "nodes": [{"name": "no Gaussians"}]}, b"")
    attributes = _attributes(splats.up_and_back())
    views, accessors, data = [], [], b""
    for array in attributes.values():
        raw = np.ascontiguousarray(array).tobytes()  # each a whole number of four bytes
        views.append({"buffer": 0, "byteOffset": len(data), "byteLength": len(raw), "target": ARRAY_BUFFER})
        accessors.append(_accessor(array, len(views) - 1))
        data += raw
    positions = attributes["POSITION"]
    accessors[0] |= {"min": positions.min(axis=0).tolist(), "max": positions.max(axis=0).tolist()}
    primitive = {
        "mode": POINTS,
        "attributes": {name: i for i, name in enumerate(attributes)},
        "extensions": {EXTENSION: {"kernel": "ellipse", "colorSpace": "srgb_rec709_display"}},
    }
    return _container(
        {
            **document,
            "extensionsUsed": [EXTENSION],
            "nodes": [{"mesh": 0}],
            "meshes": [{"primitives": [primitive]}],
            "accessors": accessors,
            "bufferViews": views,
            "buffers": [{"byteLength": len(data)}],
        },
        data,
    )


def _attributes(splats: Splats) -> dict[str, np.ndarray]:
    """Return the primitive's attributes by name, in glTF's axes; quaternions are (x, y, z, w)."""
    light, grey = (np.repeat(values[:, None], 3, axis=1) for values in (splats.intensities, splats.display()))
    seen = np.concatenate([light, splats.opacities[:, None]], axis=1)
    return {
        "POSITION": splats.means.astype("<f4"),
        f"{EXTENSION}:ROTATION": np.roll(splats.quats_wxyz, -1, axis=1).astype("<f4"),
        f"{EXTENSION}:SCALE": splats.scales.astype("<f4"),
        f"{EXTENSION}:OPACITY": np.clip(splats.opacities, 0, 1).astype("<f4"),
        f"{EXTENSION}:SH_DEGREE_0_COEF_0": ((grey - 0.5) / SH_0).astype("<f4"),
        "COLOR_0": to_bytes(255 * seen),
    }


def _accessor(array: np.ndarray, view: int) -> dict:
    """Return the accessor of an array [N] or [N, C] that lies in the buffer view `view`."""
    kind = TYPES[array.shape[1] if array.ndim == 2 else 1]
    accessor = {"bufferView": view, "componentType": FLOAT, "count": len(array), "type": kind}
    return accessor if array.dtype != np.uint8 else {**accessor, "componentType": UNSIGNED_BYTE, "normalized": True}


def _container(document: dict, data: bytes) -> bytes:
    """Return a GLB: a header of 12 bytes, then chunks, each filled up to a multiple of four bytes."""
    text = json.dumps(document, separators=(",", ":"), allow_nan=False).encode()
    chunks = [(JSON_CHUNK, text + b" " * (-len(text) % 4))]
    if data:
        chunks.append((BIN_CHUNK, data + b"\0" * (-len(data) % 4)))
    body = b"".join(struct.pack("<II", len(content), kind) + content for kind, content in chunks)
    return struct.pack("<III", MAGIC, 2, 12 + len(body)) + body


GLB = splat_format("glb", "glTF with `KHR_gaussian_splatting`: y up, linear scales", glb_bytes)
