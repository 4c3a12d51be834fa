"""The ray caster against Mitsuba 3, a renderer that shares nothing with it; skipped where that is not installed."""

from dataclasses import replace

import numpy as np
import pytest

from acquisition.scenes.bodies import KINDS
from acquisition.scenes.catalog import build_scene
from acquisition.scenes.scene import Scene
from rigs.toml import catalog_rig

mi = pytest.importorskip("mitsuba", reason="needs the mitsuba wheel, for this comparison only: pip install mitsuba")
pytestmark = pytest.mark.slow

CAMERA = catalog_rig("lab3x3").scaled(200, 125).camera("cam11")
INSTANT_S = np.array([0.01])
STRATA = 8  # rays a side of a pixel, in both


def plain(name: str) -> Scene:
    """The scene's shapes in plain colours of their own and without the ambient light, which Mitsuba has not."""
    scene = build_scene(name, 1)
    shades = iter(np.linspace(0.2, 0.9, len(scene.arrays.shapes)))
    bodies = []
    for body in scene.bodies:
        painted = [replace(s, finish=replace(s.finish, texture=0, albedo=(a, a))) for s, a in zip(body.shapes, shades)]  # noqa: B905
        bodies.append(replace(body, shapes=tuple(painted)))
    textures = np.zeros((1, 4, 4), dtype=np.float32)
    return replace(scene, bodies=tuple(bodies), textures=textures, ambient=0.0, background=0.0)


def mitsuba_scene(scene: Scene):
    geometry, placed = scene.arrays, scene.placements(INSTANT_S)
    irradiance = {"type": "rgb", "value": float(np.pi * scene.white)}
    described = {
        "type": "scene",
        "integrator": {"type": "direct", "bsdf_samples": 0, "emitter_samples": 1},
        "sun": {"type": "directional", "direction": [float(-x) for x in geometry.sun], "irradiance": irradiance},
    }
    for k, row in enumerate(geometry.shapes):
        world_from_shape = np.eye(4)
        world_from_shape[:3, :3], world_from_shape[:3, 3] = placed.rotations[0, k], placed.positions[0, k]
        paint = {"type": "diffuse", "reflectance": {"type": "rgb", "value": float(row[9])}}
        for part, (kind, shape_from_part) in enumerate(parts(KINDS[int(row[0])], row[1:4])):
            described[f"shape{k}_{part}"] = {
                "type": kind,
                "to_world": mi.ScalarTransform4f(world_from_shape @ shape_from_part),
                "bsdf": {"type": "twosided", "inner": paint},
            }
    return mi.load_dict(described)


def parts(kind: str, size: np.ndarray) -> list[tuple[str, np.ndarray]]:
    """Mitsuba's shapes that make up one of ours, and how to scale and move them."""
    a, b, c = size
    if kind == "rectangle":
        return [("rectangle", np.diag([a, b, 1.0, 1.0]))]
    if kind == "box":
        return [("cube", np.diag([a, b, c, 1.0]))]
    if kind == "sphere":
        return [("sphere", np.diag([a, a, a, 1.0]))]
    tube, low, high = np.diag([a, a, 2 * b, 1.0]), np.diag([a, a, 1.0, 1.0]), np.diag([a, a, 1.0, 1.0])
    tube[2, 3], low[2, 3], high[2, 3] = -b, -b, b  # Mitsuba's cylinder stands on z = 0 and is 1 high
    return [("cylinder", tube), ("disk", low), ("disk", high)]


def sensor():
    world_from_cam = CAMERA.cam_from_rig.inverse().matrix @ np.diag([-1.0, -1.0, 1.0, 1.0])  # its x left, y up
    return mi.load_dict(
        {
            "type": "perspective",
            "fov": float(np.degrees(2 * np.arctan(CAMERA.width / 2 / CAMERA.fx))),
            "to_world": mi.ScalarTransform4f(world_from_cam),
            "sampler": {"type": "stratified", "sample_count": STRATA**2},
            "film": {
                "type": "hdrfilm",
                "width": CAMERA.width,
                "height": CAMERA.height,
                "rfilter": {"type": "box"},
                "pixel_format": "luminance",
            },
        }
    )


def depths(mitsuba) -> np.ndarray:
    """Depth of every pixel's centre ray [H, W]; NaN where it meets nothing."""
    found = np.full((CAMERA.height, CAMERA.width), np.nan)
    turned, origin = CAMERA.cam_from_rig.rotation.T, mi.Point3f(*CAMERA.center)
    for (row, column), _ in np.ndenumerate(found):
        ray = [(column + 0.5 - CAMERA.cx) / CAMERA.fx, (row + 0.5 - CAMERA.cy) / CAMERA.fy, 1.0]
        hit = mitsuba.ray_intersect(mi.Ray3f(origin, mi.Vector3f(*(turned @ ray))))
        found[row, column] = hit.t if hit.is_valid() else np.nan
    return found


@pytest.mark.parametrize("name", ["fan_and_ball", "traffic", "deforming"])
def test_light_and_depth_are_mitsubas(name):
    mi.set_variant("scalar_rgb")
    scene = plain(name)
    ours, theirs = scene.render(CAMERA, INSTANT_S, STRATA), mitsuba_scene(scene)
    off_m = np.abs(depths(theirs) - ours.depth[0])
    light = np.array(mi.render(theirs, sensor=sensor()))[..., 0]
    psnr_db = 10 * np.log10(scene.white**2 / np.mean((light - ours.intensity[0]) ** 2))
    assert (off_m > 1e-3).sum() <= 3  # rays that graze an edge; none did
    assert np.median(off_m) < 1e-6
    assert psnr_db > 45  # 48.8 to 55.1 dB; the two cast their rays at other points of a pixel
