"""Writes a small, made-up scene as the viewer reads it, and says where its Gaussians are at any time."""

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rigs.transform import Transform

Arrays = dict[str, NDArray[np.float32]]
STILL, MOVING, KEYS = 260, 40, 5
CENTRE = (0.1, 0.0, 2.0)
WIDE, TALL = 320, 200


def camera_entry(name: str, x: float, y: float, held_out: bool = False) -> dict[str, Any]:
    """A camera at (x, y, 0), turned a little and with its principal point off the middle."""
    turn = Transform.from_rotvec(np.array([0.05 * y, -0.1 * x, 0.02]), np.zeros(3)).rotation
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = turn, -turn @ np.array([x, y, 0.0])
    lens = {"width": WIDE, "height": TALL, "fx": 300.0, "fy": 290.0, "cx": 150.0, "cy": 108.0}
    return {"id": name, **lens, "cam_from_rig": matrix.ravel().tolist(), "held_out": held_out}


CAMERAS = [
    camera_entry("cam00", -0.4, -0.3),
    camera_entry("cam01", 0.4, -0.3),
    camera_entry("cam10", 0.0, 0.05, held_out=True),
    camera_entry("cam11", 0.4, 0.3),
]


def scene_arrays(motion: str) -> Arrays:
    """A wall, a big opaque grey Gaussian before it, and a bright ball that crosses the view."""
    rng = np.random.default_rng(7)
    n = STILL + MOVING
    means = np.empty((n, 3))
    means[:STILL] = rng.uniform((-1.3, -0.9, 2.6), (1.3, 0.9, 3.2), (STILL, 3))
    means[0] = (-0.55, 0.3, 1.9)
    means[STILL:] = rng.normal((0.1, -0.15, 1.6), 0.02, (MOVING, 3))
    scales = rng.uniform(0.03, 0.09, (n, 3))
    scales[0], scales[STILL:] = 0.2, 0.02
    opacities = rng.uniform(0.3, 0.95, n)
    opacities[0], opacities[STILL:] = 0.99, 0.8
    intensities = rng.uniform(0.02, 0.3, n)
    intensities[0], intensities[STILL:] = 0.5, 1.0
    stored = {"means": means, "scales": scales, "opacities": opacities, "intensities": intensities}
    stored |= {"quats_wxyz": rng.normal(size=(n, 4)), **(path if motion == "polynomial" else keys)(rng, means)}
    return {name: np.ascontiguousarray(array, np.float32) for name, array in stored.items()}


def path(rng: np.random.Generator, means: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
    ones = np.ones((MOVING, 1))
    return {
        "velocities": ones * (0.5, 0.2, 0.3) + rng.normal(0, 0.01, (MOVING, 3)),
        "accelerations": ones * (0.3, -0.4, 0.1),
        "jerks": ones * (-0.6, 0.2, 0.4),
        "instants": rng.uniform(0.48, 0.52, MOVING),
        "durations": rng.uniform(1.5, 3.0, MOVING),
    }


def keys(rng: np.random.Generator, means: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
    steps = np.linspace(-0.4, 0.4, KEYS)[:, None, None] * (1, 0.3, 0) + rng.normal(0, 0.01, (KEYS, MOVING, 3))
    return {
        "key_means": means[STILL:] + steps,
        "key_quats": rng.normal(size=(KEYS, MOVING, 4)),
        "key_opacities": rng.uniform(0.2, 1, (KEYS, MOVING)),
        "key_scales": rng.uniform(0.01, 0.03, (KEYS, MOVING, 3)),
        "key_intensities": rng.uniform(0.1, 0.4, (KEYS, MOVING)),
    }


def unit(quats: NDArray) -> NDArray:
    return quats / np.linalg.norm(quats, axis=-1, keepdims=True)


def at(arrays: Arrays, u: float) -> Arrays:
    """All Gaussians at u in [0, 1]: the contract's formulas in float64."""
    now = {name: arrays[name].astype(float) for name in ("means", "scales", "opacities", "intensities")}
    now["quats_wxyz"] = unit(arrays["quats_wxyz"].astype(float))
    if "velocities" in arrays:
        s = (u - arrays["instants"].astype(float))[:, None]
        v, a, j = (arrays[name].astype(float) for name in ("velocities", "accelerations", "jerks"))
        now["means"][STILL:] += v * s + a * s**2 / 2 + j * s**3 / 6
        now["opacities"][STILL:] *= np.exp(-((s[:, 0] / arrays["durations"].astype(float)) ** 2) / 2)
        return now
    place = u * (KEYS - 1)
    k = min(int(place), KEYS - 2)
    t = place - k
    for name in ("means", "opacities", "scales", "intensities"):
        key = f"key_{name}"
        now[name][STILL:] = arrays[key][k].astype(float) * (1 - t) + arrays[key][k + 1].astype(float) * t
    before, after = arrays["key_quats"][k].astype(float), arrays["key_quats"][k + 1].astype(float)
    sign = np.where((before * after).sum(-1, keepdims=True) < 0, -1, 1)
    now["quats_wxyz"][STILL:] = unit(before * (1 - t) + sign * after * t)
    return now


def write_scene(folder: Path, motion: str, **facts: float) -> Arrays:
    """viewer.json and viewer.bin, as the contract has them; `facts` are what else the document says."""
    arrays, entries, blob = scene_arrays(motion), {}, b""
    for name, array in arrays.items():
        entries[name] = {"offset": len(blob), "shape": list(array.shape), "dtype": "float32"}
        blob += array.tobytes()
    manifest = {"version": 1, "count": STILL + MOVING, "still": STILL, "moving": MOVING, "clip_s": [0.0, 0.02]}
    manifest |= {"white": 0.4, "model": "cubic", "motion": motion, "degree": 3, "keyframes": KEYS, "arrays": entries}
    manifest |= {"cameras": CAMERAS, "centre": CENTRE, "depth_m": [1.2, 3.5], **facts}
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "viewer.json").write_text(json.dumps(manifest))
    (folder / "viewer.bin").write_bytes(blob)
    return arrays
