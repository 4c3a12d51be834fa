import signal
import subprocess
import sys
from dataclasses import replace
from types import MappingProxyType

import cv2
import numpy as np
import pytest

from acquisition.scenes.catalog import build_scene
from acquisition.scenes.misplaced import misplaced
from reconstruction.errors import BadRunError, GeometryError
from reconstruction.initialization.sfm import sfm
from reconstruction.metrics.poses import pose_errors
from rigs.toml import catalog_rig

DISTANCE_M = 1.8
W, H = 256, 160


@pytest.fixture(scope="module")
def rig():
    """The true one."""
    return catalog_rig("lab3x3")


def seen(rig):
    """Light of one instant: camera id to [H, W]."""
    scene = build_scene("fan_and_ball", 1)
    return MappingProxyType({c.id: scene.render(c, np.array([1e-3]), samples=3).intensity[0] for c in rig.cameras})


@pytest.fixture(scope="module")
def corner(rig):
    """Four neighbours with fewer pixels, for what needs no more."""
    return rig.scaled(W, H).only(["cam00", "cam01", "cam10", "cam11"])


@pytest.fixture(scope="module")
def images(corner):
    return seen(corner)


def test_four_views_are_placed_the_same_every_time(corner, images, capfd):
    """With the true focal length: four views hardly tell it (2.5% off when estimated)."""
    wrong = misplaced(corner, 2.0, seed=1)
    nominal = replace(wrong, cameras=tuple(replace(c, fx=224.0, fy=224.0) for c in wrong.cameras))
    one, again = (sfm(nominal, images, focal="rig") for _ in range(2))
    errors = pose_errors(one.rig, corner, DISTANCE_M)
    assert pose_errors(nominal, corner, DISTANCE_M).rotation_deg > 1
    assert errors.rotation_deg < 0.1
    assert errors.translation_percent < 0.2  # measured 0.11
    for a, b in zip(one.rig.cameras, again.rig.cameras, strict=True):
        assert np.array_equal(a.cam_from_rig.matrix, b.cam_from_rig.matrix)
        assert a.fx == b.fx
    assert np.array_equal(one.points, again.points)
    assert len(one.points) == len(one.confidence) > 300
    assert one.confidence.min() >= 2
    assert one.report["kept_nominal"] == []
    assert capfd.readouterr() == ("", "")


@pytest.mark.slow
def test_nine_views_are_placed_to_a_tenth_of_a_degree(rig, capfd):
    nominal = misplaced(rig, 2.0, seed=1)
    found = sfm(nominal, seen(rig))
    errors = pose_errors(found.rig, rig, DISTANCE_M)
    assert errors.rotation_deg < 0.1  # measured below 0.01
    assert errors.translation_percent < 0.1
    assert errors.focal_percent < 0.5
    assert found.report["estimated"] == list(rig.ids)
    assert found.report["method"] == "sfm incremental"
    assert capfd.readouterr() == ("", "")


@pytest.mark.slow
def test_the_points_lie_on_the_scene(rig):
    found = sfm(rig, seen(rig))
    scene = build_scene("fan_and_ball", 1)
    camera = rig.camera("cam11")
    depth = scene.render(camera, np.array([1e-3]), samples=1).depth[0]
    in_cam = camera.cam_from_rig.apply(found.points)
    x = in_cam @ camera.K.T
    column, row = (np.floor(x[:, k] / x[:, 2]).astype(int) for k in (0, 1))
    inside = (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
    off = np.abs(in_cam[inside, 2] / depth[row[inside], column[inside]] - 1)
    assert inside.sum() > 1000
    assert np.median(off) < 0.005


def test_the_rigs_focal_length_can_be_kept_and_a_view_without_image_stays(corner, images):
    nominal = misplaced(corner, 0.5, seed=2)
    given = {c: images[c] for c in ("cam00", "cam01", "cam10")}
    found = sfm(nominal, given, focal="rig")
    assert {c.fx for c in found.rig.cameras} == {nominal.cameras[0].fx}
    assert found.report["kept_nominal"] == ["cam11"]
    kept, before = found.rig.camera("cam11"), nominal.camera("cam11")
    assert np.array_equal(kept.cam_from_rig.matrix, before.cam_from_rig.matrix)


def test_a_view_that_sees_something_else_is_refused_by_name(corner, images):
    noise = np.random.default_rng(0).random((H, W)).astype(np.float32)
    strange = dict(images) | {"cam10": cv2.GaussianBlur(noise, (0, 0), 1.5)}
    with pytest.raises(GeometryError, match="found no place for cam10 of 4 views") as caught:
        sfm(corner, strange)
    assert caught.value.exit_code == 1


def test_lens_distortion_is_taken_out_first(corner, images):
    """A view whose lens bends light is rendered from the undistorted one and found in the same place."""
    bent = replace(corner.camera("cam01"), distortion=(-0.15, 0.03, 0.002, -0.001), fx=218.0, fy=218.0, cx=122.0)
    rig = replace(corner, cameras=tuple(bent if c.id == "cam01" else c for c in corner.cameras))
    column, row = np.meshgrid(np.arange(W) + 0.5, np.arange(H) + 0.5)
    pixels = np.stack([column, row], -1).reshape(-1, 1, 2)
    rays = cv2.undistortPoints(pixels, bent.K, np.array(bent.distortion)).reshape(H, W, 2)
    lens = corner.camera("cam01")
    where = (rays * (lens.fx, lens.fy) + (lens.cx, lens.cy) - 0.5).astype(np.float32)
    taken = cv2.remap(images["cam01"], where[..., 0], where[..., 1], cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
    found = sfm(rig, dict(images) | {"cam01": taken})
    errors = pose_errors(found.rig, rig, DISTANCE_M)
    assert np.degrees(np.linalg.norm(errors.turns_rad, axis=1)).max() < 0.1
    assert found.rig.camera("cam01").distortion == bent.distortion


def test_a_stop_is_not_a_stack_trace():
    """pycolmap takes SIGTERM for a crash; who waits for the end of a run should not see that."""
    program = """
import os, signal
from reconstruction.initialization.sfm import _quiet_pycolmap
with _quiet_pycolmap() as pycolmap:
    pycolmap.logging.info("a word that nobody should read")
os.kill(os.getpid(), signal.SIGTERM)
signal.pause()
"""
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60)
    assert ended.returncode == -signal.SIGTERM
    assert (ended.stdout, ended.stderr) == ("", "")


def test_views_without_texture_are_refused(corner):
    ramp = np.linspace(0.1, 0.5, W, dtype=np.float32) * np.ones((H, 1), np.float32)
    with pytest.raises(GeometryError, match="found no place for cam00, cam01, cam10, cam11 of 4 views"):
        sfm(corner, {c: ramp for c in corner.ids})


def test_images_that_do_not_fit_are_refused_by_name(corner, images):
    with pytest.raises(BadRunError, match="found an image of cam99, expected cameras of rig lab3x3"):
        sfm(corner, dict(images) | {"cam99": images["cam00"]})
    with pytest.raises(BadRunError, match=r"cam01: found an image of shape \(160, 255\), expected \[160, 256\]"):
        sfm(corner, dict(images) | {"cam01": images["cam01"][:, 1:]})
    with pytest.raises(BadRunError, match="cam01: found NaN"):
        sfm(corner, dict(images) | {"cam01": np.where(images["cam01"] > 0.3, np.nan, images["cam01"])})
    with pytest.raises(BadRunError, match="cam01: found an image without contrast"):
        sfm(corner, dict(images) | {"cam01": np.zeros((H, W), np.float32)})
    with pytest.raises(BadRunError, match="found images of 2 cameras, expected at least 3"):
        sfm(corner, {c: images[c] for c in ("cam00", "cam01")})
